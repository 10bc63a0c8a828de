"""Coverage of the intervals with the membrane unknown: ``python -m evidence.benchmarks.membrane_coverage FOLDER``.

``--lengths N`` and ``--outlines N`` say how many capsules of ``data/pools/membrane-capsules.npz`` there are to be of
each kind, ``--others N`` how many of ``membrane-others.npz``. Each finished one is kept in FOLDER, so that an
interrupted run resumes. ``--write`` renews ``evidence/results/membrane-coverage.json`` and the tables in
``evidence/results/membrane.md``, where the capsules are described; rows that FOLDER does not hold stay as they are.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes import Experiment, MeasuredOutline, Measurement, OutlineNoise, Surrogate
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.infer import identify
from capsbayes.membrane_database import FREE_PARAMETERS
from capsbayes.model import ForwardModel
from capsbayes.profile import vertex_normals
from capsbayes.run import Store
from capsbayes.surrogate import MembraneSurrogate
from evidence.benchmarks import membrane_pools
from evidence.benchmarks.counts import LEVELS, covered
from evidence.benchmarks.stored import Stored, complete, with_write
from evidence.markdown import table

VISCOSITY, HALF_WIDTH, VELOCITY = (0.7, 0.007), (50e-6, 0.1e-6), (4e-3, 0.01)  # with errors, the last one relative
LENGTH_ERROR, NOISE, EVERY = 0.01, OutlineNoise(0.005, 0.4, 0.1), 4
QUANTITIES = {
    "surface_shear_modulus": "G_s",
    "capsule_radius": "a",
    "pre_inflation": "alpha",
    "area_dilation_modulus": "K",
    "strain_hardening": "h",
    "bending": "B",
}
KINDS = ("lengths", "outline")
MODELS = {"unknown": "membrane unknown", "neo-Hookean": "neo-Hookean, no inflation"}
FINE = f"membrane unknown; of these those of refinement {membrane_pools.FINE}"
NOT_TO_BE_USED = "do not use"  # in the sentence of a status


@cache
def model(name: str) -> ForwardModel:
    """Return one of `MODELS`."""
    return MembraneSurrogate.open("square") if name == "unknown" else Surrogate.open("square-neo-hookean")


def capsules(pool: str = "capsules") -> dict[int, tuple[Floats, Floats, Floats]]:
    """Return values (6,), numbers (4,) and mid-plane outline (p, 2) of the capsules of a pool, by their row.

    Of members of the family those in the domain of the model; the place of others there is not known.
    """
    arrays = membrane_pools.stored(pool)
    inside = np.isnan(arrays["values"]).any(axis=1) | model("unknown").domain.contains(*arrays["values"].T)
    columns = (arrays[key] for key in ("values", "numbers", "profile"))
    return {row: capsule for row, capsule in enumerate(zip(*columns, strict=True)) if inside[row]}


def models_of(pool: str) -> dict[str, str]:
    """Return the models by which the capsules of a pool are identified, with their titles."""
    return MODELS if pool == "capsules" else {"unknown": MODELS["unknown"]}


def experiment() -> Experiment:
    """Return channel and liquid as they are known."""
    (viscosity, error), (width, width_error) = VISCOSITY, HALF_WIDTH
    return Experiment(
        cross_section="square",
        viscosity=f"{viscosity} +/- {error} Pa s",
        half_width=f"{1e6 * width} +/- {1e6 * width_error} um",
    )


def noisy_lengths(numbers: Floats, rng: np.random.Generator) -> Floats:
    """Return L_z and L_a with errors; those of a convex capsule are the same."""
    lengths = numbers[:2] + LENGTH_ERROR * rng.standard_normal(2)
    return np.full(2, lengths.mean()) if lengths[1] > lengths[0] else lengths


def noisy_outline(outline: Floats, rng: np.random.Generator) -> MeasuredOutline:
    """Return some vertices of an outline with errors along its normals."""
    vertices, normals = outline[::EVERY], vertex_normals(outline)[::EVERY]
    return MeasuredOutline(vertices + NOISE.drawn(rng, vertices, 1)[0][:, None] * normals, NOISE)


def stated(
    lengths: Floats, velocity: float, error: float, outline: MeasuredOutline | None, **flow_rate: float
) -> Measurement:
    """Return a measurement with the errors that it states."""
    return Measurement(
        axial_extent=float(lengths[0]),
        axial_extent_error=LENGTH_ERROR,
        axial_length=float(lengths[1]),
        axial_length_error=LENGTH_ERROR,
        capsule_velocity=float(velocity),
        capsule_velocity_error=float(error),
        outline=outline,
        **flow_rate,
    )


def measured(
    kind: str, values: Floats, numbers: Floats, outline: Floats, rng: np.random.Generator
) -> tuple[Measurement, dict[str, float]]:
    """Return the measurement of a capsule, and the truth."""
    lengths = noisy_lengths(numbers, rng)
    velocity, error = VELOCITY[0] * numbers[2], VELOCITY[1] * VELOCITY[0] * numbers[2]
    viscosity, width = (rng.normal(*known) for known in (VISCOSITY, HALF_WIDTH))
    noisy = noisy_outline(outline, rng)
    velocity += error * rng.standard_normal()
    seen = stated(lengths, velocity, error, noisy if kind == "outline" else None)
    truth = {"surface_shear_modulus": viscosity * VELOCITY[0] / values[0], "capsule_radius": values[1] * width}
    of_membrane = dict(zip(FREE_PARAMETERS[2:], values[2:].tolist(), strict=True))
    return seen, truth | {name: value for name, value in of_membrane.items() if np.isfinite(value)}


def identified(kind: str, name: str, row: int, capsule: tuple[Floats, Floats, Floats]) -> dict[str, Any]:
    """Return the truth, the intervals, the status and the time of one capsule, measured with errors by its row."""
    seen, truth = measured(kind, *capsule, np.random.default_rng([7, row]))
    begin = time.process_time()
    try:
        posterior = identify(seen, model(name), experiment(), engine="quadrature", seed=1, error_budget=False)
    except InputError as error:
        return {"truth": truth, "refused": str(error)}
    found = {
        quantity: asdict(posterior.marginals[quantity]) for quantity in QUANTITIES if quantity in posterior.marginals
    }
    refused = posterior.status.value if NOT_TO_BE_USED in posterior.status.value else ""
    log_modulus_sd = float(np.log(posterior.draws["surface_shear_modulus"]).std())
    further = {"status": posterior.status.name, "log_modulus_sd": log_modulus_sd, "kind": kind}
    return {"truth": truth, "refused": refused, "found": found, "seconds": time.process_time() - begin, **further}


def store_of(folder: Path, pool: str, name: str) -> Store:
    """Return the store of the capsules of a pool identified with a model."""
    settings = {"model": name, "sha256": model(name).sha256, "errors": [VISCOSITY, HALF_WIDTH, VELOCITY, LENGTH_ERROR]}
    return Store.open(folder / pool / name, settings | {"outline": asdict(NOISE)})


def run(folder: Path, pool: str, kind: str, count: int) -> None:
    """Identify the first capsules of a pool that the folder lacks."""
    chosen = list(capsules(pool).items())[:count]
    for name in models_of(pool):
        tasks = ((f"{kind}-{row:03d}", partial(identified, kind, name, row, capsule)) for row, capsule in chosen)
        complete(store_of(folder, pool, name), tasks)


def counted(folder: Path, pool: str) -> dict[str, dict[str, Any]]:
    """Return counts and medians of what a folder holds of a pool, by kind and by model or law."""
    rows, inside, stored = {}, capsules(pool), membrane_pools.stored(pool)
    groups = {name: {name: list(inside)} for name in models_of(pool)}
    if pool == "others":
        laws = {law: stored["law"] == n for n, law in enumerate(membrane_pools.OTHER_LAWS)}
        groups = {"unknown": {law: [row for row in inside if of_law[row]] for law, of_law in laws.items()}}
    else:
        groups["unknown"][FINE] = [row for row in inside if stored["refinement"][row] == membrane_pools.FINE]
    for kind in KINDS:
        for name, of_model in groups.items():
            store = store_of(folder, pool, name)
            for group, of_group in of_model.items():
                parts = [part for row in of_group if (part := store.load(f"{kind}-{row:03d}")) is not None]
                if parts:
                    rows[f"{kind}, {group}"] = counts_of(parts)
    return rows


def counts_of(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many capsules there are, how many are refused, and of the others how many intervals hold the truth."""
    used = [part for part in parts if not part["refused"]]
    counts: dict[str, Any] = {"capsules": len(parts), "refused": len(parts) - len(used)}
    for quantity in used[0]["found"] if used else ():
        for level in LEVELS:
            if quantity in used[0]["truth"]:
                counts[f"{quantity} {level}"] = sum(holds(part, quantity, level) for part in used)
    if used:
        modulus = "surface_shear_modulus"
        errors = [np.log(part["found"][modulus]["median"] / part["truth"][modulus]) for part in used]
        sds = [part["log_modulus_sd"] for part in used]
        counts |= {"log_modulus_sd": round(float(np.median(sds)), 3), "bias": round(float(np.median(errors)), 2)}
    return counts


def holds(part: dict[str, Any], quantity: str, level: int) -> bool:
    """Return whether an interval holds the truth."""
    found = part["found"][quantity]
    return bool(found[f"lower_{level}"] <= part["truth"][quantity] <= found[f"upper_{level}"])


def tables(stored: dict[str, dict[str, Any]]) -> dict[str, str]:
    """Return the table of the members of the family, and that of other laws."""
    return {"coverage": _table(stored["capsules"], "model"), "other laws": _table(stored["others"], "law")}


def _table(rows: dict[str, dict[str, Any]], identified_by: str) -> str:
    """Return the counts as a table."""
    shown = {name: symbol for name, symbol in QUANTITIES.items() if any(f"{name} 68" in row for row in rows.values())}
    head = ("measured", identified_by, "capsules", "refused", *shown.values())
    head += ("sd of ln G_s, median", "its error, median")
    return table(head, (_cells(name, counts, shown) for name, counts in rows.items()))


def _cells(name: str, counts: dict[str, Any], quantities: Iterable[str]) -> list[str]:
    kind, other = name.split(", ")
    used = counts["capsules"] - counts["refused"]
    cells = [kind, MODELS.get(other, other), str(counts["capsules"]), str(counts["refused"])]
    cells += [covered(counts, quantity, used) if f"{quantity} 68" in counts else "" for quantity in quantities]
    return cells + ([f"{counts['log_modulus_sd']:.2g}", f"{counts['bias']:+.2f}"] if used else ["", ""])


STORED = Stored("membrane-coverage.json", "evidence/results/membrane.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("folder", type=Path, help="where identified capsules are kept")
    parser.add_argument("--lengths", type=int, default=membrane_pools.CAPSULES)
    parser.add_argument("--outlines", type=int, default=membrane_pools.CAPSULES)
    parser.add_argument("--others", type=int, default=len(membrane_pools.OTHER_LAWS) * membrane_pools.OF_EACH)
    given = parser.parse_args()
    run(given.folder, "capsules", "lengths", given.lengths)
    run(given.folder, "capsules", "outline", given.outlines)
    for kind in KINDS:
        run(given.folder, "others", kind, given.others)
    rows = {pool: of_pool | counted(given.folder, pool) for pool, of_pool in STORED.read().items()}
    STORED.show(rows, write=given.write)


if __name__ == "__main__":
    main()
