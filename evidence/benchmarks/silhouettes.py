"""Silhouettes measured in drawn pictures: their noise compared with the stated one, and the posteriors from them.

Run ``python -m evidence.benchmarks.silhouettes [CAPSULES]``. The pictures are those of ``pictures``. Capsules at the
border of the database, beyond which no interval can reach, are not drawn. An interrupt ends the run and prints the
results so far; ``--write`` renews ``evidence/results/silhouettes.json`` and the tables in
``evidence/results/pictures.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from rich.progress import track
from threadpoolctl import threadpool_limits

from capsbayes import Database, Experiment, MeasuredOutline, Measurement, Surrogate
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measurement_of
from capsbayes.infer import Quadrature
from capsbayes.infer.outline import aligned_with
from capsbayes.profile import signed_area
from capsbayes.quantity import Quantity
from evidence.benchmarks.counts import LEVELS, NORMAL_ENDS
from evidence.benchmarks.pictures import SEED, scenery
from evidence.benchmarks.stored import Stored, with_write
from evidence.markdown import table
from evidence.synthetic import Drawing, draw

SETS = {"0.5 to 1 px": (0.5, 1.0), "2 px": (1.95, 2.05)}
COVERAGE = (
    *("blur", "n", "residual, l", "stated, l", "whitened square", "slow waves in 68 %, 95 %"),
    *("Ca in 68 %, 95 %", "a/l in 68 %, 95 %"),
)
WIDTHS = ("rear", "blur", "n", "ln Ca", "from lengths", "a/l", "from lengths")
FLOW, EXPERIMENT = 4e-3, Experiment(cross_section="square", half_width=50e-6, viscosity=0.7)
NAMES = ("capillary_number", "size_ratio")
MODES = 7  # waves along the outline; the first is a shift of it, which is a nuisance


@dataclass
class Tally:
    """Results of one set of pictures: numbers of the residuals, ranks of the truth, ratios of widths, by the data."""

    residuals: list[list[float]] = field(default_factory=list)
    waves: list[Floats] = field(default_factory=list)
    ranks: dict[str, list[list[float]]] = field(default_factory=lambda: {"silhouette": [], "lengths": []})
    widths: dict[bool, list[list[float]]] = field(default_factory=lambda: {True: [], False: []})
    failed: list[str] = field(default_factory=list)


class Residuals(NamedTuple):
    """Normal residuals (n,) of a measured silhouette about the true one, their stated covariance, and whitened."""

    distance: Floats
    covariance: Floats
    white: Floats


def residuals(measured: MeasuredOutline, truth: Floats) -> Residuals:
    """Return the residuals where the silhouette lies best on the true one (p, 2)."""
    points, feet = aligned_with(measured.points, truth if signed_area(truth) > 0.0 else truth[::-1])
    covariance = measured.noise.covariance(points) + measured.pose.offset**2
    factor = scipy.linalg.cholesky(covariance, lower=True)
    return Residuals(feet.distance, covariance, scipy.linalg.solve_triangular(factor, feet.distance, lower=True))


def compare(made: Drawing, measured: MeasuredOutline, tally: Tally) -> None:
    """Compare the residuals about the true silhouette with the stated noise."""
    distance, covariance, white = residuals(measured, np.asarray(made.scene.silhouette))
    angle = 2.0 * np.pi * np.arange(len(distance)) / len(distance)
    waves = np.array([np.ones_like(angle), *(turn(k * angle) for k in range(2, MODES) for turn in (np.cos, np.sin))])
    tally.waves.append((waves @ distance) / np.sqrt(np.einsum("ki,ij,kj->k", waves, covariance, waves)))
    neighbours, expected = np.mean(distance * np.roll(distance, 1)), np.mean(np.diag(covariance, 1))
    squares = np.mean(distance**2), np.mean(np.diag(covariance)), np.mean(white**2)
    tally.residuals.append([*squares[:2], neighbours, expected, squares[2]])


def weigh(engine: Quadrature, measurement: Measurement, truth: tuple[float, float], tally: Tally) -> None:
    """Compute ranks of the truth and widths of the posteriors, from the silhouette and from the lengths alone."""
    widths = []
    for data, seen in (("silhouette", measurement), ("lengths", replace(measurement, outline=None))):
        posterior = engine(seen)
        below = [posterior.probability_below(name, value) for name, value in zip(NAMES, truth, strict=True)]
        tally.ranks[data].append(below)
        widths.append([posterior.log_marginal(NAMES[0]).sd, posterior.marginal(NAMES[1]).sd])
    tally.widths[measurement.axial_length is not None].append([*widths[0], *widths[1]])


def summary(tallies: dict[str, Tally]) -> dict[str, Any]:
    """Return the numbers of each set of pictures."""
    return {name: _numbers(tally) for name, tally in tallies.items() if tally.residuals}


def _numbers(tally: Tally) -> dict[str, Any]:
    square, stated, neighbours, expected, white = np.mean(tally.residuals, axis=0)
    waves = np.abs(np.array(tally.waves))
    made: dict[str, Any] = {
        "n": len(waves),
        "omitted": sorted(tally.failed),
        "residual": float(np.sqrt(square)),
        "stated": float(np.sqrt(stated)),
        "correlation": [float(neighbours / square), float(expected / stated)],
        "white": float(white),
        "waves": {f"{level}%": float(np.mean(waves < end)) for level, end in NORMAL_ENDS.items()},
    }
    for data, below in tally.ranks.items():
        away = 200.0 * np.abs(np.array(below) - 0.5)
        made[data] = {f"{level}%": np.mean(away < level, axis=0).tolist() for level in LEVELS} | {"n": len(away)}
    made["widths"] = {
        "seen" if seen else "not seen": {"n": len(widths), "medians": np.median(np.array(widths), axis=0).tolist()}
        for seen, widths in tally.widths.items()
        if widths
    }
    return made


def tables(stored: dict[str, Any]) -> dict[str, str]:
    """Return the table of residuals and of intervals that hold the truth, and that of the median widths."""
    lines = []
    for name, found in stored.items():
        numbers = [f"{found['residual']:.4f}", f"{found['stated']:.4f}", f"{found['white']:.2f}"]
        waves = ", ".join(f"{share:.0%}" for share in found["waves"].values())
        lines.append((name, str(found["n"]), *numbers, waves, *_shares(found["silhouette"])))
    by_lengths = [found["lengths"] for found in stored.values()]
    count = sum(found["n"] for found in by_lengths)
    whole = {f"{n}%": sum(found["n"] * np.array(found[f"{n}%"]) for found in by_lengths) / count for n in LEVELS}
    lines.append(("from L_z and L_a alone", str(count), "", "", "", "", *_shares(whole)))
    return {"silhouettes": table(COVERAGE, lines), "widths": table(WIDTHS, _width_rows(stored))}


def _shares(found: dict[str, Any]) -> list[str]:
    return [", ".join(f"{found[f'{level}%'][column]:.0%}" for level in LEVELS) for column in (0, 1)]


def _width_rows(stored: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for rear in ("seen", "not seen"):
        for name, found in stored.items():
            if widths := found["widths"].get(rear):
                ca, size, ca_by_lengths, size_by_lengths = widths["medians"]
                numbers = f"{ca:.3f}", f"{ca_by_lengths:.2g}", f"{size:.4f}", f"{size_by_lengths:.2g}"
                yield rear, name, str(widths["n"]), *numbers


STORED = Stored("silhouettes.json", "evidence/results/pictures.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=60, help="number of capsules (default: 60)")
    given = parser.parse_args()
    cases, random = Database.open("square-neo-hookean").converged, np.random.default_rng(SEED)
    tallies = {name: Tally() for name in SETS}
    with threadpool_limits(limits=1), suppress(KeyboardInterrupt):
        for number in track(range(given.count), description="capsules", transient=True):
            name = list(SETS)[number % len(SETS)]
            one_capsule(cases, SETS[name], random, tallies[name])
    STORED.show(summary(tallies), write=given.write)
    for name, tally in tallies.items():
        print(f"{name}: {len(tally.failed)} omitted: {', '.join(sorted(tally.failed)) or 'none'}")


def without_one(cases: Database, random: np.random.Generator) -> tuple[Database, Surrogate]:
    """Return a random case, and a surrogate of the others that has a prediction there and all around."""
    columns = [cases[name] for name in NAMES]
    within = np.all([(one > one.min()) & (one < one.max()) for one in columns], axis=0)
    while True:
        row = int(random.choice(np.flatnonzero(within)))
        case = Database(cases.dataset.isel(case=[row]))
        others = Database(cases.dataset.isel(case=np.delete(np.arange(len(cases)), row)))
        surrogate = Surrogate(others, view="silhouette")
        if surrogate({name: case[name] for name in NAMES}).inside[0]:
            return case, surrogate


def one_capsule(cases: Database, blur: tuple[float, float], random: np.random.Generator, tally: Tally) -> None:
    """Draw, measure and identify one capsule; omit it if its flow direction or its edge is not found."""
    case, surrogate = without_one(cases, random)
    scene, optics = scenery(case, blur, random)
    made = draw(scene, optics, seed=int(random.integers(2**31)))
    seen = Picture.from_array(made.picture)
    detection = detect(seen, background=Picture.from_array(made.background))
    speed = FLOW * float(case["velocity_ratio"][0])
    measured = measurement_of(detection, seen, EXPERIMENT, Quantity(speed, 0.01 * speed, "m/s"))
    if measured.outline is None:
        tally.failed.append(detection.status.name if not detection.status.ok else "no direction")
        return
    compare(made, measured.outline, tally)
    try:
        truth = float(case["capillary_number"][0]), float(case["size_ratio"][0])
        weigh(Quadrature(surrogate, EXPERIMENT), measured, truth, tally)
    except InputError:
        tally.failed.append("no such shape")


if __name__ == "__main__":
    main()
