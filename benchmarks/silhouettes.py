"""Silhouettes measured in drawn pictures: their noise compared with the stated one, and the posteriors from them.

Run ``python benchmarks/silhouettes.py [CAPSULES]``. The pictures are those of ``benchmarks/pictures.py``, of simulated
capsules, each of which is omitted from the surrogate that identifies it; those at the border of the database, beyond
which no interval can reach, are not drawn. The first table gives the normal residuals of the measured silhouettes about
the true ones; the second the shares of the intervals of Ca and a/l that contain the truth, and their widths compared
with those from the lengths of the same pictures. An interrupt ends the run and prints the results so far.
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from pictures import scenery
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from capsbayes import Database, Experiment, MeasuredOutline, Measurement, Surrogate
from capsbayes.errors import InputError
from capsbayes.image.files.picture import Picture
from capsbayes.image.measure import detect, measurement_of
from capsbayes.image.synthetic import Drawing, draw
from capsbayes.infer import Quadrature
from capsbayes.infer.outline.likelihood import aligned_with
from capsbayes.profile import signed_area
from capsbayes.quantity import Quantity

SETS = {"sharp, 0.5 to 1 px": (0.5, 1.0), "blurred, 2 px": (1.95, 2.05)}
FLOW, EXPERIMENT = 4e-3, Experiment(cross_section="square", half_width=50e-6, viscosity=0.7)
NAMES = ("capillary_number", "size_ratio")
MODES = 7  # waves along the outline; the first is a shift of it, which is a nuisance
Floats = NDArray[np.float64]


@dataclass
class Tally:
    """Results of one set of pictures: numbers of the residuals, ranks of the truth, ratios of widths, by the data."""

    residuals: list[list[float]] = field(default_factory=list)
    waves: list[Floats] = field(default_factory=list)
    ranks: dict[str, list[list[float]]] = field(default_factory=lambda: {"silhouette": [], "lengths": []})
    widths: dict[bool, list[list[float]]] = field(default_factory=lambda: {True: [], False: []})
    failed: list[str] = field(default_factory=list)


def compare(made: Drawing, measured: MeasuredOutline, tally: Tally) -> None:
    """Compute the normal residuals about the true silhouette, whitened with the stated noise."""
    truth = np.asarray(made.scene.silhouette)
    points, feet = aligned_with(measured.points, truth if signed_area(truth) > 0.0 else truth[::-1])
    noise = measured.noise
    covariance = noise.covariance(points) + measured.pose.offset**2
    white = scipy.linalg.solve_triangular(scipy.linalg.cholesky(covariance, lower=True), feet.distance, lower=True)
    angle = 2.0 * np.pi * np.arange(len(points)) / len(points)
    waves = np.array([np.ones_like(angle), *(turn(k * angle) for k in range(2, MODES) for turn in (np.cos, np.sin))])
    tally.waves.append((waves @ feet.distance) / np.sqrt(np.einsum("ki,ij,kj->k", waves, covariance, waves)))
    stated = np.sqrt(np.mean(np.diag(covariance)))
    neighbours = np.mean(feet.distance * np.roll(feet.distance, 1))
    expected = np.mean(np.diag(covariance, 1))
    tally.residuals.append([np.mean(feet.distance**2), stated**2, neighbours, expected, np.mean(white**2)])


def weigh(engine: Quadrature, measurement: Measurement, truth: tuple[float, float], tally: Tally) -> None:
    """Compute ranks of the truth and widths of the posteriors, from the silhouette and from the lengths alone."""
    widths = []
    for data, seen in (("silhouette", measurement), ("lengths", replace(measurement, outline=None))):
        posterior = engine(seen)
        below = [posterior.probability_below(name, value) for name, value in zip(NAMES, truth, strict=True)]
        tally.ranks[data].append(below)
        widths.append([posterior.log_marginal(NAMES[0]).sd, posterior.marginal(NAMES[1]).sd])
    tally.widths[measurement.axial_length is not None].append([*widths[0], *widths[1]])


def noise_table(tallies: dict[str, Tally]) -> Table:
    headings = (
        "blur",
        "n",
        "scatter l",
        "stated",
        "correlation",
        "stated",
        "white square",
        "waves in 68 %",
    )
    table = Table(*headings, "in 95 %", title="residuals of measured silhouettes")
    for name, tally in tallies.items():
        square, stated, neighbours, expected, white = np.mean(tally.residuals, axis=0)
        waves = np.abs(np.array(tally.waves))
        within = [f"{np.mean(waves < limit):.0%}" for limit in (0.99446, 1.95996)]
        sizes = [f"{np.sqrt(square):.5f}", f"{np.sqrt(stated):.5f}", f"{neighbours / square:.2f}"]
        table.add_row(name, str(len(waves)), *sizes, f"{expected / stated:.2f}", f"{white:.2f}", *within)
    return table


def coverage_table(tallies: dict[str, Tally]) -> Table:
    table = Table("blur", "from", "n", "68 %: Ca, a/l", "95 %: Ca, a/l", title="intervals that hold the truth")
    for name, tally in tallies.items():
        for data, below in tally.ranks.items():
            away = np.abs(np.array(below) - 0.5)
            shares = [np.mean(away < level / 2, axis=0) for level in (0.68, 0.95)]
            table.add_row(name, data, str(len(away)), *(f"{ca:.0%}, {size:.0%}" for ca, size in shares))
    return table


def width_table(tallies: dict[str, Tally]) -> Table:
    headings = ("blur", "rear", "n", "sd of ln Ca", "of a/l", "from lengths", "of a/l", "times narrower", "of a/l")
    table = Table(*headings, title="medians of the posteriors' widths")
    for name, tally in tallies.items():
        for seen, widths in tally.widths.items():
            if widths:
                every = np.array(widths)
                ratio = np.median(every[:, 2:] / every[:, :2], axis=0)
                cells = [*(f"{sd:.4f}" for sd in np.median(every, axis=0)), *(f"{one:.1f}" for one in ratio)]
                table.add_row(name, "seen" if seen else "not seen", str(len(every)), *cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=60, help="number of capsules (default: 60)")
    parser.add_argument("--seed", type=int, default=2024)
    asked = parser.parse_args()
    cases, random = Database.open("square-neo-hookean").converged, np.random.default_rng(asked.seed)
    tallies = {name: Tally() for name in SETS}
    with threadpool_limits(limits=1), suppress(KeyboardInterrupt):
        for number in track(range(asked.count), description="capsules", transient=True):
            name = list(SETS)[number % len(SETS)]
            one(cases, SETS[name], random, tallies[name])
    console = Console(width=130)
    for table in (noise_table, coverage_table, width_table):
        console.print(table(tallies))
    for name, tally in tallies.items():
        console.print(f"{name}: {len(tally.failed)} left out: {', '.join(sorted(tally.failed)) or 'none'}")


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


def one(cases: Database, blur: tuple[float, float], random: np.random.Generator, tally: Tally) -> None:
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
