"""Compare every shipped surrogate with simulations at the nodes of its database, and off them.

Run ``python -m evidence.benchmarks.off_nodes [NAME ...]``; ``--write`` renews the table in
``evidence/results/off-nodes.md``, where it is described. A stated error counts as flagged where the surrogate has the
caveat of two shapes or of unsure shapes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Integers
from capsbayes.database import NO_EFFECT, Database
from capsbayes.model import TWO_SHAPES, UNSURE_SHAPES, ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate import Surrogate
from evidence.benchmarks.fresh import FRESH
from evidence.benchmarks.stored import POOL_FOLDER, RESULTS, with_write
from evidence.exam.sessions import POOLS, pool_name
from evidence.markdown import renew, table

PAGE = RESULTS / "off-nodes.md"
QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")
HEAD = (
    *("database", "where", "shapes inside", "L_z, 10⁻³ l: rms (largest)", "L_a", "v_o/U"),
    *("rms of z", "largest z", "outline", "largest stated error"),
)
CONVEX = 1e-4


class Shapes(NamedTuple):
    """Simulated shapes."""

    where: str  # "nodes", the size of the effect, or "fresh"
    theta: dict[str, np.ndarray]
    values: np.ndarray  # (n, 3): L_z, L_a, v_o/U
    depth: np.ndarray  # (n,), of the rear [l]
    outlines: np.ndarray | None  # (n, p, 2)


class Row(NamedTuple):
    """Comparison of one surrogate with one set of shapes; z and errors of L_z, L_a and v_o/U."""

    database: str
    where: str
    inside: int
    count: int
    rms: np.ndarray
    largest: np.ndarray
    z: np.ndarray
    largest_z: np.ndarray
    outline_z: float
    stated: float
    wrong_branch: int


def at_nodes(database: Database, model: ForwardModel) -> Shapes:
    """Return the shapes of a database at its own nodes."""
    cases = database.converged
    theta = {name: cases[name] for name in ("capillary_number", "size_ratio")}
    theta |= dict.fromkeys(model.coordinates, cases["effect_value"])
    return Shapes("nodes", theta, np.stack([cases[name] for name in QUANTITIES], 1), cases["parachute_depth"], None)


def off_nodes(name: str) -> Iterator[Shapes]:
    """Yield the stored simulations off the nodes of a database."""
    database = Database.open(name)
    of_plain = {"square-neo-hookean": ("none", 0.0), "square-hooke": ("hooke_share", 1.0)}
    for effect, size in POOLS:
        path = POOL_FOLDER / f"{pool_name(effect, size)}.nc"
        fits = (effect, size) == of_plain.get(name) if database.effect == NO_EFFECT else effect == database.effect
        if fits and name.startswith("square") and path.exists():
            cases = Database.read(path).converged
            theta = {key: cases[key] for key in ("capillary_number", "size_ratio")}
            if database.effect != NO_EFFECT:
                theta[effect] = np.full(len(cases), size)
            values = np.stack([cases[key] for key in QUANTITIES], axis=1)
            label = "pool" if database.effect == NO_EFFECT else f"{effect.replace('_', ' ')} {size:g}"
            yield Shapes(label, theta, values, cases["parachute_depth"], cases["profile"])
    with np.load(FRESH, allow_pickle=False) as stored:
        chosen = stored["database"] == name
        if chosen.any():
            theta = {key: stored[key][chosen] for key in ("capillary_number", "size_ratio")}
            if database.effect != NO_EFFECT:
                theta[database.effect] = stored["effect_value"][chosen]
            values = np.stack([stored[key][chosen] for key in QUANTITIES], axis=1)
            half = stored["half_profile"][chosen].astype(float)
            mirrored = half[:, -2:0:-1] * [1.0, -1.0]
            yield Shapes("fresh", theta, values, stored["parachute_depth"][chosen], np.concatenate([half, mirrored], 1))


def compared(name: str, model: ForwardModel, shapes: Shapes, *, outlines: bool = True) -> Row:
    """Compare a surrogate with simulated shapes."""
    found = model(shapes.theta, outline=outlines and shapes.outlines is not None)
    none, caveats = np.zeros(len(found), dtype=bool), model.caveats(shapes.theta)
    inside, two_shapes = found.inside, caveats.get(TWO_SHAPES, none)
    flagged = two_shapes | caveats.get(UNSURE_SHAPES, none)
    wrong = ((shapes.depth < CONVEX) != (found.parachute_depth < CONVEX)) & inside
    kept = inside & ~(wrong & two_shapes)  # it says that the other shape is stable too
    away, sd = (found.values - shapes.values)[kept], np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))[kept]
    z, stated = away / sd, (sd[:, :2] / found.values[kept, :2]).max(axis=1)
    return Row(
        name,
        shapes.where,
        int(inside.sum()),
        len(inside),
        np.sqrt(np.mean(away**2, axis=0)),
        np.abs(away).max(axis=0),
        np.sqrt(np.mean(z**2, axis=0)),
        np.abs(z).max(axis=0),
        outline_z(model, shapes, found, np.flatnonzero(kept)) if found.outline is not None else np.nan,
        float(stated[~flagged[kept]].max(initial=0.0)),
        int(wrong.sum()),
    )


def outline_z(model: ForwardModel, shapes: Shapes, found: Prediction, kept: Integers) -> float:
    """Return the rms over shapes of the rms displacement of the outline over the rms of its stated error."""
    ratios = []
    for k in kept[:: max(1, len(kept) // 20)]:
        modes = model.outline_modes(**{key: float(value[k]) for key, value in shapes.theta.items()})
        away = np.sum((shapes.outlines[k] - found.outline[k]) * vertex_normals(found.outline[k]), axis=1)
        ratios.append(np.mean(away**2) / np.mean(np.sum(modes**2, axis=0)))
    return float(np.sqrt(np.mean(ratios)))


def on_its_mesh(name: str) -> ForwardModel:
    """Open a shipped surrogate without the error of the mesh of its plain database, or of its base."""
    database = Database.open(name)
    if database.effect == NO_EFFECT:
        return Surrogate.from_database(without_mesh_error(database))
    base = database.plain_relative()
    return Surrogate.from_database(database, base=without_mesh_error(base) if base is not None else None)


def without_mesh_error(database: Database) -> Database:
    """Return a database that states no error of its mesh."""
    attributes = {key: value for key, value in database.dataset.attrs.items() if key != "mesh_error"}
    dataset = database.dataset.copy()
    dataset.attrs = attributes
    return Database(dataset)


def rows(name: str) -> list[Row]:
    """Compare one shipped surrogate with its nodes, then with everything that is off them."""
    database, model = Database.open(name), on_its_mesh(name)
    alone = model if database.effect == NO_EFFECT else Surrogate.from_database(without_mesh_error(database))
    made = [compared(name, alone, at_nodes(database, alone))]
    return made + [compared(name, model, shapes) for shapes in off_nodes(name)]


def cells(row: Row) -> list[str]:
    """Return the cells of a row of the table."""
    error = [f"{1e3 * rms:.2f} ({1e3 * most:.1f})" for rms, most in zip(row.rms, row.largest, strict=True)]
    z, most = (", ".join(f"{value:.2f}" for value in values) for values in (row.z, row.largest_z))
    outline = "" if np.isnan(row.outline_z) else f"{row.outline_z:.2f}"
    label, inside = (row.database if row.where == "nodes" else ""), f"{row.inside} of {row.count}"
    return [label, row.where, inside, *error, z, most, outline, f"{100 * row.stated:.1f} %"]


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="databases; by default every shipped one")
    given = parser.parse_args()
    text = table(HEAD, (cells(row) for name in given.names or Database.shipped() for row in rows(name)))
    print(text)
    if given.write:
        renew(PAGE, "nodes", text)


if __name__ == "__main__":
    main()
