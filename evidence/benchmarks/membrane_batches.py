"""Coverage of what a batch tells of its membrane: ``python -m evidence.benchmarks.membrane_batches FOLDER``.

``--lengths N`` and ``--outlines N`` say how many batches of ``data/pools/membrane-batches.npz`` there are to be of each
kind. Each finished one is kept in FOLDER, so that an interrupted run resumes. ``--write`` renews
``evidence/results/membrane-batches.json`` and the tables in ``evidence/results/membrane.md``, where the batches are
described.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes import MeasuredOutline, Measurement
from capsbayes.arrays import Floats
from capsbayes.infer import Membrane
from capsbayes.infer.prior import Marginal
from capsbayes.infer.shared_membrane import SharedMembrane, capsules_of, identify_membrane
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES
from capsbayes.parameters import PARAMETERS
from capsbayes.run import Store
from evidence.benchmarks import membrane_coverage, membrane_pools
from evidence.benchmarks.counts import LEVELS, covered
from evidence.benchmarks.membrane_coverage import (
    HALF_WIDTH,
    LENGTH_ERROR,
    NOISE,
    VELOCITY,
    VISCOSITY,
    noisy_lengths,
    noisy_outline,
    stated,
)
from evidence.benchmarks.stored import Stored, complete, with_write
from evidence.markdown import table

PUMP = 0.01
QUANTITIES = {
    "surface_shear_modulus": "mean G_s",
    **{name: membrane_coverage.QUANTITIES[name] for name in FREE_PARAMETERS[2:]},
    "surface_shear_modulus_each": "G_s of each",
}
INFLATED = {name: PARAMETERS[name].label for name in ("pre_inflation", "inflation_spread", "surface_shear_modulus")}
OF_MESHES = {name: PARAMETERS[name].label for name in ("surface_shear_modulus", *FREE_PARAMETERS[2:])}
READINGS = {"one": False, "varying": True}
MEMBRANES = {
    "unknown": Membrane(),
    "neo-Hookean": Membrane("neo-Hookean", pre_inflation=0.0, bending=NULL_VALUES[-1]),
}
CHOSEN_ON = 14  # batches at which the method was tried while it was made


class Session:
    """One batch: its measurements with one or another noise, flow rates and truths."""

    def __init__(self, pool: dict[str, Floats], number: int, kind: str, noise: int = 0) -> None:
        rows = np.flatnonzero(pool["batch"] == number)
        of_batch = {key: pool[key][rows] for key in ("values", "numbers", "profile", "relative_modulus", "flow_factor")}
        self.kind = kind
        self.rng = np.random.default_rng([11, number, noise] if noise else [11, number])
        self.viscosity, self.width = (self.rng.normal(*known) for known in (VISCOSITY, HALF_WIDTH))
        self.speeds = VELOCITY[0] * of_batch["flow_factor"]
        pump = 1.0 + PUMP * self.rng.standard_normal()
        self.measurements = [
            self._measured(numbers, outline, speed, pump)
            for numbers, outline, speed in zip(of_batch["numbers"], of_batch["profile"], self.speeds, strict=True)
        ]
        moduli = self.viscosity * self.speeds / of_batch["values"][:, 0]
        middle = float(moduli[0] / of_batch["relative_modulus"][0])
        of_membrane = dict(zip(FREE_PARAMETERS[2:], of_batch["values"][0, 2:].tolist(), strict=True))
        if "relative_inflation" in pool:
            of_membrane["pre_inflation"] /= pool["relative_inflation"][rows[0]]
            of_membrane["inflation_spread"] = pool["inflation_spread"][rows[0]]
        self.truth = {"surface_shear_modulus": middle, "surface_shear_modulus_each": moduli, **of_membrane}

    def _measured(self, numbers: Floats, outline: Floats, speed: float, pump: float) -> Measurement:
        lengths, noisy = noisy_lengths(numbers, self.rng), noisy_outline(outline, self.rng)
        error, rate = VELOCITY[1] * speed * numbers[2], float(4.0 * self.width**2 * speed * pump)
        velocity = speed * numbers[2] + error * self.rng.standard_normal()
        seen = noisy if self.kind == "outline" else None
        return stated(lengths, velocity, error, seen, flow_rate=rate, flow_rate_error=PUMP * rate)

    def found(self, membrane: str) -> SharedMembrane:
        """Return the membrane that the capsules tell."""
        how = {"seed": 1, "membrane": MEMBRANES[membrane], "laws": False}
        return identify_membrane(self.measurements, membrane_coverage.experiment(), **how)


def coverage(session: Session, membrane: str) -> dict[str, Any]:
    """Return how many intervals there are of each quantity and level, and how many of them hold the truth."""
    begin = time.process_time()
    found = session.found(membrane)
    counts: dict[str, Any] = {"status": found.status.name}
    for name in QUANTITIES:
        if name in found.draws and np.ptp(found.draws[name]) > 0.0:
            columns = found.draws[name].reshape(len(found.draws[name]), -1).T
            counts |= held(name, [Marginal.of_draws(column) for column in columns], np.atleast_1d(session.truth[name]))
    log_moduli = np.log(found.draws["surface_shear_modulus"])
    return counts | {"log_modulus_sd": float(log_moduli.std()), "seconds": time.process_time() - begin}


def held(name: str, marginals: list[Marginal], truth: Floats) -> dict[str, int]:
    """Return the number of intervals of a quantity, and of those at each level that hold the truth."""
    pairs = list(zip(marginals, truth.tolist(), strict=True))
    counts = {f"{name} {level}": sum(one.contains(true, level=level) for one, true in pairs) for level in LEVELS}
    return counts | {name: len(pairs)}


def inflated(session: Session) -> dict[str, Any]:
    """Return median and ends of the 95 % interval, and the truth, by how the batch is read and by quantity."""
    found: dict[str, Any] = {}
    for reading, varies in READINGS.items():
        told = identify_membrane(
            session.measurements, membrane_coverage.experiment(), seed=1, laws=False, inflation_varies=varies
        )
        for name in INFLATED.keys() & told.marginals.keys():
            marginal = told.marginals[name]
            ends = marginal.median, marginal.lower_95, marginal.upper_95, session.truth[name]
            found[f"{reading} {name}"] = [float(f"{value:.4g}") for value in ends]
    return found


def told(session: Session) -> dict[str, Any]:
    """Return what a batch tells with all laws tried: intervals with the truth, capsules held, and the likeliest law."""
    found = identify_membrane(session.measurements, membrane_coverage.experiment(), seed=1)
    answers: dict[str, Any] = {"status": found.status.name}
    for name in OF_MESHES:
        marginal = found.marginals[name]
        ends = marginal.median, marginal.lower_95, marginal.upper_95, session.truth[name]
        answers[name] = [float(f"{value:.4g}") for value in ends]
    each = held("each", found.of_each("surface_shear_modulus"), session.truth["surface_shear_modulus_each"])
    likeliest = max(found.laws, key=lambda law: law.probability)
    return answers | {**each, "law": likeliest.name, "probability": float(f"{likeliest.probability:.2g}")}


def tail() -> float:
    """Return the 95 % quantile of the model's error over its stated one, along what tells a membrane."""
    pool, model = membrane_pools.stored("capsules"), membrane_coverage.model("unknown")
    experiment = membrane_coverage.experiment()
    exact = []
    for numbers, outline in zip(pool["numbers"], pool["profile"], strict=True):
        lengths, vertices = np.minimum(numbers[:2], numbers[0]), outline[:: membrane_coverage.EVERY]
        velocity, error = numbers[2] * VELOCITY[0], VELOCITY[1] * VELOCITY[0]
        exact.append(stated(lengths, velocity, error, MeasuredOutline(vertices, NOISE)))
    capsules = capsules_of(exact, experiment, model)
    theta = dict(zip(FREE_PARAMETERS, pool["values"].T, strict=True))
    steps = np.array([1e-3 * np.median(values) for values in theta.values()])
    moved = [{**theta, name: theta[name] + step} for name, step in zip(theta, steps, strict=True)]
    seen = capsules.model(theta)
    _, slopes = capsules.model.with_slopes(theta, moved)
    inside = np.isfinite(seen.log_ratio)
    rows = capsules.batch.rows[inside]
    away = capsules.batch.target[inside] - (rows @ seen.numbers[inside, :, None])[..., 0]
    along = rows @ np.moveaxis(slopes.numbers[:, inside] / steps[:, None, None], 0, -1)
    error = rows @ seen.covariances[inside] @ rows.swapaxes(1, 2)
    weight = np.linalg.inv(error + np.eye(error.shape[1]))
    own, of_membrane = along[..., :2], along[..., 2:]
    taken = weight @ own @ np.linalg.inv(own.swapaxes(1, 2) @ weight @ own) @ own.swapaxes(1, 2) @ weight
    telling = of_membrane.swapaxes(1, 2) @ (weight - taken)
    variance = np.einsum("naq,nqp,nap->na", telling, error, telling)
    score = np.abs((telling @ away[..., None])[..., 0]) / np.sqrt(variance)
    return float(f"{np.quantile(score, 0.95):.2g}")


def run(folder: Path, kind: str, count: int) -> None:
    """Identify the first batches that the folder lacks."""
    pool, store = membrane_pools.stored("batches"), store_of(folder)
    for number in np.unique(pool["batch"]).astype(int)[:count].tolist():
        session = Session(pool, number, kind)
        tasks = {f"{kind}-{membrane}-coverage-{number:02d}": membrane for membrane in MEMBRANES}
        complete(store, ((name, partial(coverage, session, membrane)) for name, membrane in tasks.items()))


def run_inflated(folder: Path) -> None:
    """Read the inflated batches that the folder lacks."""
    pool = membrane_pools.stored("inflated")
    sessions = {number: Session(pool, number, "outline") for number in np.unique(pool["batch"]).astype(int).tolist()}
    tasks = ((f"inflated-{number:02d}", partial(inflated, session)) for number, session in sessions.items())
    complete(store_of(folder), tasks)


def run_meshes(folder: Path) -> None:
    """Identify the batches that were simulated on several meshes, which the folder lacks."""
    tasks = []
    for refinement in membrane_pools.MESHES:
        pool = membrane_pools.stored("meshes")
        rows = pool["refinement"] == refinement
        of_mesh = {name: values[rows] for name, values in pool.items() if len(values) == len(rows)}
        for number in np.unique(of_mesh["batch"]).astype(int).tolist():
            session = Session(of_mesh, number, "outline")
            tasks.append((f"meshes-{number:02d}-{refinement:02d}", partial(told, session)))
    complete(store_of(folder), tasks)


def store_of(folder: Path) -> Store:
    """Return the store of identified batches."""
    errors = [VISCOSITY, HALF_WIDTH, VELOCITY, LENGTH_ERROR, PUMP]
    return Store.open(folder, {"sha256": membrane_coverage.model("unknown").sha256, "errors": errors})


def counted(folder: Path) -> dict[str, Any]:
    """Return counts and medians of what a folder holds, by table, and by kind and membrane."""
    store, rows = store_of(folder), {}
    fine = {f"{number:02d}" for number in membrane_pools.numbers_of("batches")[membrane_pools.FINE]}
    for kind, membrane in product(membrane_coverage.KINDS, MEMBRANES):
        names = sorted(store.names(f"{kind}-{membrane}-coverage-*"))
        parts = [part for name in names if (part := store.load(name)) is not None]
        if parts:
            rows[f"{kind}, {membrane}"] = counts_of(parts)
        if membrane == "unknown" and len(parts) > CHOSEN_ON:
            rows[f"{kind}, unknown (batches {CHOSEN_ON + 1} on)"] = counts_of(parts[CHOSEN_ON:])
            of_fine = [part for name, part in zip(names, parts, strict=True) if name[-2:] in fine]
            rows[f"{kind}, unknown (refinement {membrane_pools.FINE})"] = counts_of(of_fine)
    counts: dict[str, Any] = {"coverage": rows}
    names = sorted(store.names("inflated-*"))
    counts["inflated"] = {str(number + 1): store.load(name) for number, name in enumerate(names)}
    of_meshes = sorted(store.names("meshes-*"))
    counts["meshes"] = {name.removeprefix("meshes-"): store.load(name) for name in of_meshes}
    return counts | {"tail": tail()}


def counts_of(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the sums over batches, and how many of them are not to be used."""
    refused = sum(part["status"] not in ("DONE", "LEANS_ON_BORDER") for part in parts)
    counts: dict[str, Any] = {"batches": len(parts), "not to be used": refused}
    for key in parts[0]:
        if key not in ("status", "seconds", "log_modulus_sd"):
            counts[key] = sum(part.get(key, 0) for part in parts)
    return counts | {"log_modulus_sd": float(f"{np.median([part['log_modulus_sd'] for part in parts]):.2g}")}


def tables(counts: dict[str, Any]) -> dict[str, str]:
    """Return the tables by the marks of the page."""
    shown = {
        "batches": _table(counts["coverage"]),
        "inflated": table(("batch", "read as of", *INFLATED.values()), _inflated_rows(counts["inflated"])),
    }
    if counts.get("meshes"):
        head = ("batch", "simulated at", *OF_MESHES.values(), "capsules in 95 %", "likeliest law", "status")
        shown["meshes"] = table(head, _rows_of_meshes(counts["meshes"]))
    return shown


def _table(rows: dict[str, dict[str, Any]]) -> str:
    """Return counts as a table."""
    lines = []
    for name, counts in rows.items():
        cells = [*name.split(", "), str(counts["batches"]), str(counts["not to be used"])]
        cells += [covered(counts, each, counts[each]) if counts.get(each) else "" for each in QUANTITIES]
        lines.append([*cells, f"{counts['log_modulus_sd']:.2g}"])
    head = ("measured", "membrane", "batches", "not to be used", *QUANTITIES.values(), "sd of ln mean G_s, median")
    return table(head, lines)


def _inflated_rows(batches: dict[str, dict[str, Any]]) -> Iterator[list[str]]:
    """Yield what batches with an inflation that varies tell: the truth, and the answer of each reading."""
    for number, answers in batches.items():
        truth = [PARAMETERS[name].shown(answers[f"varying {name}"][3]) for name in INFLATED]
        yield [number, "the truth", *(f"{value:.3g}" for value in truth)]
        for reading in READINGS:
            found = [answers.get(f"{reading} {name}", [])[:3] for name in INFLATED]
            shown = [[PARAMETERS[name].shown(end) for end in ends] for name, ends in zip(INFLATED, found, strict=True)]
            cells = ["{:.3g} ({:.3g} to {:.3g})".format(*ends) if ends else "" for ends in shown]
            yield [number, f"{reading} inflation", *cells]


def _rows_of_meshes(answers: dict[str, dict[str, Any]]) -> Iterator[list[str]]:
    """Yield what the same capsules tell on each mesh, after the truth."""
    for name, answer in answers.items():
        batch, refinement = map(int, name.split("-"))
        ends = {key: [PARAMETERS[key].shown(value) for value in answer[key]] for key in OF_MESHES}
        if refinement == membrane_pools.MESHES[0]:
            yield [str(batch + 1), "the truth", *(f"{ends[key][3]:.3g}" for key in OF_MESHES), "", "", ""]
        cells = ["{:.3g} ({:.3g} to {:.3g})".format(*ends[key][:3]) for key in OF_MESHES]
        held_by = f"{answer['each 95']} of {answer['each']}"
        law = f"{answer['law']} {100 * answer['probability']:.0f} %"
        yield [str(batch + 1), f"refinement {refinement}", *cells, held_by, law, answer["status"]]


STORED = Stored("membrane-batches.json", "evidence/results/membrane.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("folder", type=Path, help="where identified batches are kept")
    parser.add_argument("--lengths", type=int, default=membrane_pools.BATCHES["batches"])
    parser.add_argument("--outlines", type=int, default=membrane_pools.BATCHES["batches"])
    parser.add_argument("--only-meshes", action="store_true", help="only those that were simulated on several meshes")
    given = parser.parse_args()
    if membrane_pools.pool_of("meshes").exists():
        run_meshes(given.folder)
    if given.only_meshes:
        STORED.show(STORED.read() | {"meshes": counted(given.folder)["meshes"]}, write=given.write)
        return
    run(given.folder, "lengths", given.lengths)
    run(given.folder, "outline", given.outlines)
    run_inflated(given.folder)
    STORED.show(counted(given.folder), write=given.write)


if __name__ == "__main__":
    main()
