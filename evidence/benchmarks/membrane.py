"""Compare the surrogate over flow and membrane with states left out, and with shapes at random places.

Run ``python -m evidence.benchmarks.membrane``; ``--write`` renews the table in ``evidence/results/membrane.md``.
"""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.membrane_database import FREE_PARAMETERS, THICK, MembraneDatabase
from capsbayes.profile import vertex_normals
from capsbayes.surrogate import MembraneSurrogate
from evidence.benchmarks import membrane_pools
from evidence.benchmarks.stored import RESULTS, with_write
from evidence.markdown import renew, table

PAGE = RESULTS / "membrane.md"
FOLDS = 10
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


def chosen(values: Floats) -> dict[str, Booleans]:
    """Return which of parameters (n, 6) are of each kind."""
    thin = values[:, 5] <= THICK
    usual = thin & (values[:, 2] <= 0.05)
    return {
        "B up to 1e-3": thin,
        "and alpha up to 0.05": usual,
        "and K from 1.5": usual & (values[:, 3] >= 1.5),
        "B from 1e-3": ~thin,
    }


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
    lines = [row(f"left out, {name}", *(part[rows] for part in found)) for name, rows in chosen(values).items()]
    model, capsules = MembraneSurrogate(database), membrane_pools.stored("capsules")
    for refinement in (membrane_pools.USUAL, membrane_pools.FINE):
        rows = capsules["refinement"] == refinement
        there = [capsules[name][rows] for name in ("values", "numbers", "profile")]
        values, *found = compared(model, there[0], there[1][:, :3], there[2])
        parts = chosen(values) if refinement == membrane_pools.USUAL else {"all": slice(None)}
        for name, some in parts.items():
            lines.append(row(f"fresh, refinement {refinement}, {name}", *(part[some] for part in found)))
    values, *found = left_out(MembraneDatabase.open("circular"))
    lines += [
        row(f"circular, left out, {name}", *(part[rows] for part in found)) for name, rows in chosen(values).items()
    ]
    return table(HEAD, lines)


def main() -> None:
    given = with_write(__doc__).parse_args()
    text = errors()
    print(text)
    if given.write:
        renew(PAGE, "errors", text)


if __name__ == "__main__":
    main()
