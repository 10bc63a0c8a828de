"""Compare the surrogate over flow and membrane with states left out, and with simulations on a finer mesh.

Run ``python -m evidence.benchmarks.membrane``; ``--write`` renews the table in ``evidence/results/membrane.md``.
``--simulate FOLDER`` first simulates shapes at random places, which are no states, on a mesh of refinement 12; each
finished one is kept in FOLDER, and those that were reached are stored in ``data/fresh-membrane.npz``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Floats
from capsbayes.membrane_database import FREE_PARAMETERS, MembraneDatabase
from capsbayes.physics.scattered import NUMBERS, membrane_continuation
from capsbayes.profile import vertex_normals
from capsbayes.run import Store
from capsbayes.surrogate import MembraneSurrogate
from evidence.benchmarks import membrane_pools
from evidence.benchmarks.stored import RESULTS, ROOT, with_write
from evidence.markdown import renew, table
from evidence.rebuild import membrane_places

PAGE, FRESH = RESULTS / "membrane.md", ROOT / "data" / "fresh-membrane.npz"
FOLDS, COUNT, FINE = 10, 40, 12
HEAD = (
    *("", "shapes", "outline, rms, l/1000", "median", "L_z, rms, %", "median", "L_a, rms, %", "median"),
    *("v_o/U, rms, %", "median", "z, rms", "largest"),
)


def left_out(database: MembraneDatabase) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the parameters of all states, differences of (L_z, L_a, v_o/U) over them, z, and rms displacements."""
    fold = np.random.default_rng(0).permutation(len(database)) % FOLDS
    found = []
    for number in range(FOLDS):
        states = database.taken(np.flatnonzero(fold == number))
        model = MembraneSurrogate(database.taken(np.flatnonzero(fold != number)))
        outline = states["profile_mean"] + np.tensordot(states["profile"], states["profile_modes"], axes=1)
        found.append(compared(model, states["values"], states["numbers"][:, :3], outline))
    values, relative, score, displaced = (np.concatenate(part) for part in zip(*found, strict=True))
    return values, relative, score, displaced


def compared(model: MembraneSurrogate, values: Floats, numbers: Floats, outline: Floats) -> tuple[Floats, ...]:
    """Return the same of given shapes that lie in the domain of a model."""
    seen = model(dict(zip(FREE_PARAMETERS, values.T, strict=True)), outline=True)
    inside = seen.inside
    away = (seen.values - numbers)[inside]
    score = away / np.sqrt(np.einsum("nii->ni", seen.covariance[inside]))
    normal = np.sum((seen.outline[inside] - outline[inside]) * vertex_normals(outline[inside]), axis=-1)
    return values[inside], away / numbers[inside], score, np.sqrt(np.mean(normal**2, axis=1))


def row(name: str, relative: Floats, score: Floats, displaced: Floats) -> list[str]:
    """Return a line of the table."""
    cells = [name, f"{len(displaced)}", f"{1e3 * rms(displaced):.2g}", f"{1e3 * np.median(displaced):.2g}"]
    for column in relative.T:
        cells += [f"{100 * rms(column):.2g}", f"{100 * np.median(np.abs(column)):.2g}"]
    return [*cells, f"{rms(score):.2g}", f"{np.abs(score).max():.2g}"]


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def errors() -> str:
    """Return the table of errors."""
    database = MembraneDatabase.open("square")
    values, *found = left_out(database)
    inflation, modulus = values[:, 2], values[:, 3]
    chosen = {
        "all": np.ones(len(values), dtype=bool),
        "alpha up to 0.05": inflation <= 0.05,
        "alpha up to 0.05, K from 1.5": (inflation <= 0.05) & (modulus >= 1.5),
    }
    lines = [row(f"left out, {name}", *(part[rows] for part in found)) for name, rows in chosen.items()]
    model, capsules = MembraneSurrogate(database), membrane_pools.stored("capsules")
    values, *found = compared(model, capsules["values"], capsules["numbers"][:, :3], capsules["profile"])
    rows = values[:, 2] <= 0.05
    lines.append(row("fresh, refinement 8, all", *found))
    lines.append(row("fresh, refinement 8, alpha up to 0.05", *(part[rows] for part in found)))
    with np.load(FRESH) as fresh:
        _, *of_fresh = compared(model, fresh["values"], fresh["numbers"], fresh["profile"])
    lines.append(row("fresh, refinement 12", *of_fresh))
    _, *found = left_out(MembraneDatabase.open("circular"))
    lines.append(row("circular, left out, all", *found))
    return table(HEAD, lines)


def simulate(folder: Path) -> None:
    """Simulate the shapes that the folder lacks, and store those that were reached."""
    fine = membrane_continuation("square", FINE)
    store, random = Store.open(folder, fine.settings), qmc.Sobol(len(FREE_PARAMETERS), rng=11).random_base2(6)[:COUNT]
    values = fine.values(membrane_places(fine, random))
    try:
        with threadpool_limits(limits=1):
            membrane_pools.simulate_singles(store, fine, "shape", range(COUNT), lambda number: values[number])
    finally:
        parts = [part for name in sorted(store.names()) if (part := store.load(name)) is not None and part["reached"]]
        columns = {
            "values": [part["values"] for part in parts],
            "numbers": [part["numbers"][: len(NUMBERS) - 1] for part in parts],
            "profile": [part["profile"].reshape(-1, 2) for part in parts],
        }
        np.savez_compressed(FRESH, **{name: np.array(column) for name, column in columns.items()})


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("--simulate", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    if given.simulate is not None:
        simulate(given.simulate)
    text = errors()
    print(text)
    if given.write:
        renew(PAGE, "errors", text)


if __name__ == "__main__":
    main()
