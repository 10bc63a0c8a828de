"""Lengths measured in drawn pictures: bias, coverage of the intervals, seconds.

Run ``python -m evidence.benchmarks.pictures [COUNT]``. Each picture shows a simulated capsule drawn at random from a
shipped database, with optics drawn at random: three sets of blur, each measured with the background given.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.stats import binom
from threadpoolctl import threadpool_limits

from capsbayes.database import Database
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from evidence.benchmarks.counts import NORMAL_ENDS
from evidence.benchmarks.stored import arguments
from evidence.markdown import table
from evidence.synthetic import Drawing, Optics, Scene, draw

SETS = {"sharp, 0.5 to 1 px": (0.5, 1.0), "1 to 1.7 px": (1.0, 1.7), "blurred, 1.7 to 2.2 px": (1.7, 2.2)}
LENGTHS = {"L_z": 0, "L_a": 1, "l": 3}  # their places among the measured ones
SEED = 2024
HEAD = ("blur", "", "n", "bias px", "scatter px", "error px", "in 68 %", "by chance", "in 95 %", "by chance")
MARGIN = 35.0  # px around the capsule


@dataclass
class Tally:
    """Results of one set of pictures."""

    errors: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: {name: [] for name in LENGTHS})
    statuses: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=300, help="number of pictures (default: 300)")
    given = parser.parse_args()
    cases, random = Database.open("square-neo-hookean").converged, np.random.default_rng(SEED)
    tallies = {name: Tally() for name in SETS}
    with threadpool_limits(limits=1):
        for number in track(range(given.count), description="pictures", transient=True):
            name = list(SETS)[number % len(SETS)]
            count(drawn(cases, SETS[name], random), tallies[name])
    print(table(HEAD, rows(tallies)))
    for name, tally in tallies.items():
        ended = ", ".join(f"{key} {value}" for key, value in tally.statuses.items())
        print(f"{name}: {ended}; processor {1e3 * float(np.median(tally.seconds)):.1f} ms a picture (median)")


def drawn(cases: Database, blur: tuple[float, float], random: np.random.Generator) -> Drawing:
    """Return a drawn picture with a capsule, a position and optics at random."""
    scene, optics = scenery(cases, blur, random)
    return draw(scene, optics, seed=int(random.integers(2**31)))


def scenery(cases: Database, blur: tuple[float, float], random: np.random.Generator) -> tuple[Scene, Optics]:
    """Return a scene with a capsule, a position and optics at random."""
    case = int(random.integers(len(cases)))
    half_width = random.uniform(45.0, 70.0)
    optics = Optics(
        blur=random.uniform(*blur),
        motion=random.choice([0.0, random.uniform(0.5, 2.0)]),
        band_depth=random.uniform(0.45, 0.75),
        band_width=random.uniform(3.5, 7.0),
        interior=random.uniform(0.1, 0.35),
        halo=random.uniform(0.0, 0.1),
        halo_width=random.uniform(1.5, 4.0),
        rear_depth=random.uniform(0.2, 0.5),
        rear_width=random.uniform(2.0, 4.0),
        wall_depth=random.uniform(0.4, 0.7),
        wall_width=random.uniform(1.5, 3.0),
        outside=random.uniform(0.85, 1.0),
        vignetting=random.uniform(0.0, 0.3),
        unevenness=random.uniform(-0.1, 0.1),
        full_light=random.uniform(150.0, 210.0),
        electrons=10.0 ** random.uniform(3.3, 4.3),
    )
    columns = max(200, int(half_width * np.ptp(cases["silhouette"][case][:, 0]) + 2.0 * MARGIN))
    scene = Scene(
        cases["profile"][case],
        cases["silhouette"][case],
        half_width,
        shape=(200, columns),
        centre=(0.5 * columns + random.uniform(-8.0, 8.0), 99.5 + random.uniform(-5.0, 5.0)),
        tilt=random.uniform(-0.04, 0.04),
        flow=int(random.choice([-1, 1])),
    )
    return scene, optics


def count(made: Drawing, tally: Tally) -> None:
    picture, background = Picture.from_array(made.picture), Picture.from_array(made.background)
    start = time.process_time()
    seen = detect(picture, background=background)
    tally.seconds.append(time.process_time() - start)
    tally.statuses[seen.status.name] += 1
    if not seen.status.ok:
        return
    tally.statuses["rear seen" if seen.rear is not None else "rear not seen"] += 1
    sd, truth = np.sqrt(np.diag(seen.covariance)), (made.axial_extent, made.axial_length, made.half_width)
    for (name, place), true in zip(LENGTHS.items(), truth, strict=True):
        if np.isfinite(seen.lengths[place]):
            tally.errors[name].append((seen.lengths[place] - true, sd[place]))


def rows(tallies: dict[str, Tally]) -> Iterator[list[str]]:
    """Yield what is counted of each length in each set of pictures, and in all of them."""
    whole = Tally()
    for name in LENGTHS:
        whole.errors[name] = [pair for tally in tallies.values() for pair in tally.errors[name]]
    for name, tally in {**tallies, "all": whole}.items():
        for length in LENGTHS:
            if tally.errors[length]:
                yield [name, length, *row(np.array(tally.errors[length]))]


def row(pairs: NDArray[np.float64]) -> list[str]:
    error, sd = pairs.T
    cells = [f"{len(error)}", f"{error.mean():+.3f}", f"{error.std():.3f}", f"{np.sqrt(np.mean(sd**2)):.3f}"]
    for level, end in NORMAL_ENDS.items():
        low, high = binom.ppf([0.025, 0.975], len(error), level / 100) / len(error)
        cells += [f"{np.mean(np.abs(error) < end * sd):.1%}", f"{low:.0%}..{high:.0%}"]
    return cells


if __name__ == "__main__":
    main()
