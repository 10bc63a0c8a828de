"""The silhouette of a film against those of its frames: ``python -m evidence.benchmarks.film_silhouettes [FILMS]``.

Each film shows a simulated capsule that passes ``evidence/benchmarks/camera.py``, which shares no code with what
measures it, and which is omitted from the surrogate that identifies it; viscosity and half width are known.

``evidence/results/films.json`` keeps each film when it is done: an interrupted run goes on there. ``--write`` renews
the table in ``evidence/results/pictures.md``.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capsbayes import Database, Experiment, Measurement
from capsbayes.errors import InputError
from capsbayes.experiment import capillary_number
from capsbayes.image.files import Picture
from capsbayes.image.film import measure_film
from capsbayes.image.measure import detect, silhouette_of
from capsbayes.infer import Quadrature
from evidence.benchmarks.camera import Grey, View, film
from evidence.benchmarks.conditions import CONDITIONS, HALF_WIDTH, scenery
from evidence.benchmarks.counts import LEVELS
from evidence.benchmarks.silhouettes import NAMES, without_one
from evidence.benchmarks.stored import Stored, with_write
from evidence.markdown import table

FRAMES, RATE, SEED = 6, 1000.0, 4021
SHOWN = ("none", "noise 2 %", "blur 2 px")  # conditions, in turn
EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85, frame_rate=RATE)
SOURCES = ("film", "frames", "lengths of the film")
HEAD = (
    *("condition", "by", "n", "G_s in 68 %", "in 95 %", "a/l in 68 %", "in 95 %", "sd of ln G_s", "sd of a/l"),
    *("film over best frame: median", "largest"),
)


def taken(number: int, cases: Database) -> tuple[View, list[Grey], Grey, float]:
    """Return the view, the frames, the empty channel and the step [px] of a film, drawn at random by its number."""
    random = np.random.default_rng([SEED, number])
    view, camera = CONDITIONS[SHOWN[number % len(SHOWN)]](*scenery(cases, random), random)
    step = float(random.uniform(8.0, 30.0))
    rows, columns = view.shape
    wide = int(columns + FRAMES * step)
    (capsule,), half = view.capsules, 0.5 * (FRAMES - 1) * step
    centre = 0.5 * (wide - 1) - half * view.along[0], 0.5 * (rows - 1) - half * view.along[1]
    view = replace(view, shape=(rows, wide), capsules=(replace(capsule, centre=centre),))
    frames, empty = film(view, camera, step * np.arange(FRAMES), seed=number)
    return view, frames, empty, step


def row(number: int, cases: Database) -> dict[str, Any]:
    """Return what is found of the capsule of a film: each posterior as rank of the truth and width, for G_s and a/l."""
    case, surrogate = without_one(cases, np.random.default_rng([SEED, number, 1]))
    view, frames, empty, step = taken(number, case)
    made: dict[str, Any] = {"condition": SHOWN[number % len(SHOWN)]}
    with tempfile.TemporaryDirectory() as place:
        for index, frame in enumerate(frames):
            cv2.imwrite(str(Path(place) / f"{index}.png"), frame)
        found = measure_film(place, EXPERIMENT, background=empty)
    done = [capsule for capsule in found.capsules if capsule.status.ok]
    made["status"] = done[0].status.name if done else ", ".join(each.status.name for each in found.capsules)
    if not done:
        return made
    together = done[0].measurement
    flow = "right" if view.flow > 0 else "left"
    alone = [detect(Picture.from_array(frame), background=Picture.from_array(empty), flow=flow) for frame in frames]
    shared = {"axial_length": None, "axial_length_error": None, "length_correlation": 0.0}
    each = [replace(together, outline=silhouette_of(detection), **shared) for detection in alone if detection.status.ok]
    engine = Quadrature(surrogate, EXPERIMENT)
    speed = step / HALF_WIDTH * EXPERIMENT.half_width.mean * RATE
    truth = _truth(case, speed)
    made["film"] = found_by(engine, replace(together, **shared), truth)
    made["frames"] = [found_by(engine, one, truth) for one in each if one.outline is not None]
    made["lengths of the film"] = found_by(engine, replace(together, outline=None), truth)
    return made


def _truth(case: Database, speed: float) -> tuple[float, float]:
    """Return G_s [N/m] and the radius [m] of a case whose capsule moves at a speed [m/s]."""
    mean, half_width = speed / float(case["velocity_ratio"][0]), EXPERIMENT.half_width.mean
    of_unit = capillary_number(viscosity=EXPERIMENT.viscosity.mean, mean_velocity=mean, surface_shear_modulus=1.0)
    return float(of_unit / case[NAMES[0]][0]), float(case[NAMES[1]][0]) * half_width


def found_by(engine: Quadrature, measurement: Measurement, truth: tuple[float, float]) -> list[float] | None:
    """Return the probability below the true G_s, the sd of ln G_s, and the same of a/l; None if no shape fits."""
    try:
        posterior = engine(measurement)
    except InputError:
        return None
    names = ("surface_shear_modulus", "capsule_radius")
    below = [posterior.probability_below(name, value) for name, value in zip(names, truth, strict=True)]
    widths = posterior.log_marginal(names[0]).sd, posterior.marginal(names[1]).sd / EXPERIMENT.half_width.mean
    return [float(number) for number in (below[0], widths[0], below[1], widths[1])]


def tables(stored: dict[str, Any]) -> dict[str, str]:
    """Return the table: each condition, then all films."""
    lines = []
    for name in (*SHOWN, "all"):
        films = [film for film in stored.values() if name in (film["condition"], "all") and film.get("film")]
        for source in SOURCES if films else ():
            lines.append((name if source == SOURCES[0] else "", source, *_cells(films, source)))
    return {"films": table(HEAD, lines)}


def _cells(films: list[dict[str, Any]], source: str) -> list[str]:
    posteriors = [each for film in films for each in (film["frames"] if source == "frames" else [film[source]])]
    numbers = np.array([posterior for posterior in posteriors if posterior])
    away = 200.0 * np.abs(numbers[:, [0, 2]] - 0.5)
    shares = [f"{np.mean(away[:, column] < level):.0%}" for column in (0, 1) for level in LEVELS]
    sds = [f"{np.median(numbers[:, column]):.4f}" for column in (1, 3)]
    over = ratios(films)
    last = [f"{np.median(over):.2f}", f"{np.max(over):.2f}"] if source == "film" else ["", ""]
    return [str(len(numbers)), *shares, *sds, *last]


def ratios(films: list[dict[str, Any]]) -> list[float]:
    """Return the standard deviation of ln G_s by the film over that by its frame that tells most, for each film."""
    return [film["film"][1] / min(each[1] for each in film["frames"] if each) for film in films if any(film["frames"])]


STORED = Stored("films.json", "evidence/results/pictures.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=6, help="number of films (default: 6)")
    given = parser.parse_args()
    cases = Database.open("square-neo-hookean").converged
    films = STORED.completed((str(number), partial(row, number, cases)) for number in range(given.count))
    STORED.show(films, write=given.write)


if __name__ == "__main__":
    main()
