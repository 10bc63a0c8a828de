"""Coverage of the intervals with the membrane unknown: ``python -m evidence.benchmarks.membrane_coverage FOLDER``.

The capsules are those of ``data/pools/membrane-capsules.npz`` in the domain of the model: simulated one by one, with
membranes drawn from the default priors. Each is measured with errors: its lengths to 0.01 l, or its mid-plane outline
to 0.005 l; its velocity to 1 %, the viscosity to 1 %, the half width to 0.2 %. It is identified with the membrane
unknown, and with the default model, which takes it as neo-Hookean and not inflated. Of each it is counted whether the
68 % and 95 % intervals hold the truth. So it is, with the membrane unknown, of ``data/pools/membrane-others.npz``:
capsules whose laws are no members of the family.

``--lengths N`` and ``--outlines N`` say how many capsules there are to be of each kind. Each finished one is kept in
FOLDER, so that an interrupted run resumes. ``--write`` renews ``evidence/results/membrane-coverage.json`` and the
tables in ``evidence/results/membrane.md``; rows that FOLDER does not hold stay as they are.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import asdict
from functools import cache
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
from evidence.benchmarks.population_coverage import share
from evidence.markdown import renew

ROOT = Path(__file__).parents[2]
STORED, PAGE = ROOT / "evidence" / "results" / "membrane-coverage.json", ROOT / "evidence" / "results" / "membrane.md"
MARKS = {
    "capsules": ("<!-- coverage -->\n", "<!-- end of coverage -->\n"),
    "others": ("<!-- other laws -->\n", "<!-- end of other laws -->\n"),
}
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
LEVELS = (68, 95)
KINDS = {"lengths": "lengths", "outline": "outline"}
MODELS = {"unknown": "membrane unknown", "neo-Hookean": "neo-Hookean, no inflation"}
NOT_TO_BE_USED = "do not use"  # in the sentence of a status


@cache
def model(name: str) -> ForwardModel:
    """Return one of `MODELS`."""
    return MembraneSurrogate.open("square") if name == "unknown" else Surrogate.open("square-neo-hookean")


def capsules(pool: str = "capsules") -> dict[int, tuple[Floats, Floats, Floats]]:
    """Return values (6,), numbers (4,) and mid-plane outline (p, 2) of the capsules of a pool, by their row.

    Of members of the family those in the domain of the model; the place of others there is not known.
    """
    there = membrane_pools.stored(pool)
    inside = np.isnan(there["values"]).any(axis=1) | model("unknown").domain.contains(*there["values"].T)
    seen = (there[key] for key in ("values", "numbers", "profile"))
    return {row: capsule for row, capsule in enumerate(zip(*seen, strict=True)) if inside[row]}


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


def measured(
    kind: str, values: Floats, numbers: Floats, outline: Floats, rng: np.random.Generator
) -> tuple[Measurement, dict[str, float]]:
    """Return the measurement of a capsule, and the truth."""
    lengths = numbers[:2] + LENGTH_ERROR * rng.standard_normal(2)
    if lengths[1] > lengths[0]:  # of a convex capsule, whose lengths are the same
        lengths[:] = lengths.mean()
    velocity, error = VELOCITY[0] * numbers[2], VELOCITY[1] * VELOCITY[0] * numbers[2]
    viscosity, width = (rng.normal(*stated) for stated in (VISCOSITY, HALF_WIDTH))
    vertices = outline[::EVERY]
    away = NOISE.drawn(rng, vertices, 1)[0][:, None] * vertex_normals(outline)[::EVERY]
    seen = Measurement(
        axial_extent=float(lengths[0]),
        axial_extent_error=LENGTH_ERROR,
        axial_length=float(lengths[1]),
        axial_length_error=LENGTH_ERROR,
        capsule_velocity=float(velocity + error * rng.standard_normal()),
        capsule_velocity_error=float(error),
        outline=MeasuredOutline(vertices + away, NOISE) if kind == "outline" else None,
    )
    truth = {"surface_shear_modulus": viscosity * VELOCITY[0] / values[0], "capsule_radius": values[1] * width}
    of_membrane = dict(zip(FREE_PARAMETERS[2:], values[2:].tolist(), strict=True))
    return seen, truth | {name: value for name, value in of_membrane.items() if np.isfinite(value)}


def identified(kind: str, name: str, seen: Measurement, truth: dict[str, float]) -> dict[str, Any]:
    """Return the truth, the intervals, the status and the time of one capsule."""
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
    for number, (row, capsule) in enumerate(list(capsules(pool).items())[:count], start=1):
        for name in models_of(pool):
            store, part = store_of(folder, pool, name), f"{kind}-{row:03d}"
            if not store.holds(part):
                seen = measured(kind, *capsule, np.random.default_rng([7, row]))
                store.save(part, identified(kind, name, *seen))
        print(f"{pool}, {kind}: {number} of {count}", flush=True)


def counted(folder: Path, pool: str) -> dict[str, dict[str, Any]]:
    """Return counts and medians of what a folder holds of a pool, by kind and by model or law."""
    rows, inside = {}, capsules(pool)
    groups = {"": list(inside)}
    if pool == "others":
        laws = membrane_pools.stored(pool)["law"]
        groups = {law: [row for row in inside if laws[row] == n] for n, law in enumerate(membrane_pools.OTHER_LAWS)}
    for kind in KINDS:
        for name in models_of(pool):
            store = store_of(folder, pool, name)
            for law, of_law in groups.items():
                parts = [part for row in of_law if (part := store.load(f"{kind}-{row:03d}")) is not None]
                if parts:
                    rows[f"{kind}, {law or name}"] = counts_of(parts)
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


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Return the counts as a Markdown table."""
    shown = {name: symbol for name, symbol in QUANTITIES.items() if any(f"{name} 68" in row for row in rows.values())}
    laws = all(name.split(", ")[1] in membrane_pools.OTHER_LAWS for name in rows)
    head = ("measured", "law" if laws else "model", "capsules", "refused", *shown.values())
    head = (*head, "sd of ln G_s, median", "its error, median")
    lines = [f"| {' | '.join(head)} |\n", "|---" * len(head) + "|\n"]
    for name, counts in rows.items():
        kind, other = name.split(", ")
        used = counts["capsules"] - counts["refused"]
        cells = [KINDS[kind], MODELS.get(other, other), str(counts["capsules"]), str(counts["refused"])]
        for quantity in shown:
            there = f"{quantity} 68" in counts
            held = [counts[f"{quantity} {level}"] for level in LEVELS] if there else []
            cells.append(f"{held[0] / used:.0%}, {share(held[1], used)}" if there else "")
        cells += [f"{counts['log_modulus_sd']:.2g}", f"{counts['bias']:+.2f}"] if used else ["", ""]
        lines.append(f"| {' | '.join(cells)} |\n")
    return re.sub(" ?%", " %", "".join(lines))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where identified capsules are kept")
    parser.add_argument("--lengths", type=int, default=150)
    parser.add_argument("--outlines", type=int, default=60)
    parser.add_argument("--others", type=int, default=2 * membrane_pools.OF_EACH)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    run(options.folder, "capsules", "lengths", options.lengths)
    run(options.folder, "capsules", "outline", options.outlines)
    for kind in KINDS:
        run(options.folder, "others", kind, options.others)
    stored = json.loads(STORED.read_text())
    rows = {pool: stored[pool] | counted(options.folder, pool) for pool in MARKS}
    print(*map(table, rows.values()), sep="\n")
    if options.write:
        STORED.write_text(json.dumps(rows, indent=1) + "\n")
        for pool, marks in MARKS.items():
            renew(PAGE, *marks, table(rows[pool]))


if __name__ == "__main__":
    main()
