"""Compare the surrogate over flow and membrane with states left out, and with simulations on a finer mesh.

Run ``python -m evidence.benchmarks.membrane``; ``--write`` renews the table in ``evidence/results/membrane.md``. Each
state is predicted from nine tenths of the others, and the capsules of ``data/pools/membrane-capsules.npz`` from all.
``--simulate FOLDER`` first simulates shapes at random places, which are no states, on a mesh of refinement 12; each
finished one is kept in FOLDER, and those that were reached are stored in ``data/fresh-membrane.npz``. z is a difference
over the stated error.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Floats
from capsbayes.membrane_database import FREE_PARAMETERS, MembraneDatabase
from capsbayes.physics.scattered import NUMBERS, membrane_continuation, nearest_state
from capsbayes.profile import vertex_normals
from capsbayes.run import Store
from capsbayes.surrogate import MembraneSurrogate
from evidence.benchmarks import membrane_pools
from evidence.markdown import renew
from evidence.rebuild import membrane_places

ROOT = Path(__file__).parents[2]
PAGE, STORED = ROOT / "evidence" / "results" / "membrane.md", ROOT / "data" / "fresh-membrane.npz"
FOLDS, COUNT, FINE = 10, 40, 12
BEGIN, END = "<!-- errors -->", "<!-- end of errors -->"
COLUMNS = (
    *("shapes", "outline, rms, l/1000", "median", "L_z, rms, %", "median", "L_a, rms, %", "median"),
    *("v_o/U, rms, %", "median", "z, rms", "largest"),
)
HEAD = f"| | {' | '.join(COLUMNS)} |\n{'|---' * (len(COLUMNS) + 1)}|\n"


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


def row(name: str, relative: Floats, score: Floats, displaced: Floats) -> str:
    """Return a line of the table."""
    cells = [f"{len(displaced)}", f"{1e3 * rms(displaced):.2g}", f"{1e3 * np.median(displaced):.2g}"]
    for column in relative.T:
        cells += [f"{100 * rms(column):.2g}", f"{100 * np.median(np.abs(column)):.2g}"]
    cells += [f"{rms(score):.2g}", f"{np.abs(score).max():.2g}"]
    return f"| {name} | {' | '.join(cells)} |\n"


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def table() -> str:
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
    with np.load(STORED) as fresh:
        _, *of_fresh = compared(model, fresh["values"], fresh["numbers"], fresh["profile"])
    lines.append(row("fresh, refinement 12", *of_fresh))
    _, *found = left_out(MembraneDatabase.open("circular"))
    lines.append(row("circular, left out, all", *found))
    return HEAD + "".join(lines)


def some_points(count: int) -> tuple[MembraneSurrogate, dict[str, Floats]]:
    """Return the model for square channels and points at its states, drawn at random."""
    model = MembraneSurrogate.open("square")
    values = model.membrane_database["values"]
    rows = np.random.default_rng(1).integers(0, len(values), count)
    return model, dict(zip(FREE_PARAMETERS, values[rows].T, strict=True))


def simulate(folder: Path) -> None:
    """Simulate the shapes that the folder lacks, each from the nearest state."""
    database = MembraneDatabase.open("square")
    fine = membrane_continuation("square", FINE)
    store, random = Store.open(folder, fine.settings), qmc.Sobol(len(FREE_PARAMETERS), rng=11).random_base2(6)[:COUNT]
    stretched = membrane_places(fine, random)
    for number, place in enumerate(stretched):
        name = f"shape-{number:03d}"
        if store.holds(name):
            continue
        state = fine.reached(nearest_state(database, fine, place), place)
        seen = {} if state is None else fine.seen(state)
        store.save(name, {"values": fine.values(place[None])[0], "reached": state is not None, **seen})
        print(f"{number + 1} of {COUNT}", flush=True)


def store_reached(folder: Path) -> None:
    """Store the shapes of a folder that were reached."""
    store = Store.open(folder, membrane_continuation("square", FINE).settings)
    parts = [part for name in sorted(store.names()) if (part := store.load(name)) is not None and part["reached"]]
    columns = {
        "values": [part["values"] for part in parts],
        "numbers": [part["numbers"][: len(NUMBERS) - 1] for part in parts],
        "profile": [part["profile"].reshape(-1, 2) for part in parts],
    }
    np.savez_compressed(STORED, **{name: np.array(column) for name, column in columns.items()})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulate", type=Path, metavar="FOLDER")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.simulate is not None:
        try:
            with threadpool_limits(limits=1):
                simulate(options.simulate)
        finally:
            store_reached(options.simulate)
    text = table()
    print(text)
    if options.write:
        renew(PAGE, BEGIN, END, f"\n{text}")
