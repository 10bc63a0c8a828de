"""From drawn pictures to G_s, under the faults of a recording.

Run ``python -m evidence.benchmarks.picture_moduli [COUNT]``. The pictures are drawn as in ``conditions``, of shapes of
the exam that lie between those of the database; every second capsule is seen with rings of light about its edge.
``--keep FILE`` keeps the answers to each capsule, so that an interrupted run goes on there. ``--write`` renews
``evidence/results/picture-moduli.json`` and the table in ``evidence/results/pictures.md``, where it is described.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from capsbayes import Database, Experiment, Surrogate, identify
from capsbayes.errors import InputError
from capsbayes.image import ByHand
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measurement_of, turned
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from evidence.benchmarks.camera import Camera, Floats, Grey, View
from evidence.benchmarks.conditions import CONDITIONS, HALF_WIDTH, PLAIN, Taken, rings, taken
from evidence.benchmarks.counts import LEVELS, NORMAL_ENDS, percent
from evidence.benchmarks.membrane_batches import held
from evidence.benchmarks.membrane_coverage import NOT_TO_BE_USED
from evidence.benchmarks.stored import POOL_FOLDER, Stored, completed, with_write
from evidence.exam.sessions import read_pool
from evidence.markdown import table

VISCOSITY = Quantity(0.7, 0.007, "Pa s")
FLOW = 4e-3  # m/s, mean velocity of the liquid
OF_VELOCITY = 0.01  # relative error
EXPERIMENT = Experiment(cross_section="square", half_width=50e-6, viscosity=VISCOSITY)
WAYS = {"silhouette": "silhouette", "lengths": "mid-plane"}  # and the view of their model
QUANTITIES = ("capillary_number", "surface_shear_modulus")
HEAD = (
    *("condition", "measured", "refused", "L_z in 68 %, 95 %", "by silhouettes", "Ca", "G_s", "ln G_s: sd, error"),
    *("by lengths", "Ca", "G_s", "ln G_s: sd, error"),
)


def finely_ringed(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
    """Add rings of 4 to 7 px and any phase in a halo of 5 to 15 %."""
    looks = replace(view.looks, **rings(random), halo=random.uniform(0.05, 0.15))
    return replace(view, looks=looks), camera


OPTICS = {"without rings": PLAIN, "with rings": finely_ringed}

Fault = Callable[[Grey, Grey, View, np.random.Generator], tuple[Grey, Grey]]


def spotted(picture: Grey, empty: Grey, view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
    """Lay a dark spot of 7 px on the edge of the capsule."""
    edge = view.placed(view.capsules[0].silhouette, view.capsules[0])
    middle = np.rint(edge[random.integers(len(edge))]).astype(int).tolist()
    return np.asarray(cv2.circle(picture.copy(), middle, 3, 60, -1, cv2.LINE_AA), dtype=np.uint8), empty


def bumped(picture: Grey, empty: Grey, view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
    """Push the middle of the rear outwards by 3 px, smoothly over 19 px."""
    rows, columns = np.indices(picture.shape)
    away = np.stack([columns, rows], axis=-1) - view.capsules[0].centre
    towards = np.clip(-2.0 * (away @ view.along) / view.axial_extent, 0.0, 1.0)  # 0 in the middle, 1 from the rear on
    way = 3.0 * towards**2 * np.exp(-0.5 * np.square(away @ view.across / 8.0))
    x, y = ((place + way * step).astype(np.float32) for place, step in zip((columns, rows), view.along, strict=True))
    light = (picture / _light(empty)).astype(np.float32)
    return _before(cv2.remap(light, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), empty)


def read_by_rows(picture: Grey, empty: Grey, view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
    """Read the rows one after the other, so that what moves is displaced by 4 px over l."""
    columns, rows = np.arange(picture.shape[1]), np.arange(len(picture))
    late = 4.0 / HALF_WIDTH * (rows - rows.mean())
    moved = [np.interp(columns - way, columns, line) for way, line in zip(late, picture / _light(empty), strict=True)]
    return _before(np.array(moved), empty)


def askew(picture: Grey, empty: Grey, view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
    """Turn the capsule, but not the channel, by 2 degrees."""
    turn = cv2.getRotationMatrix2D(view.capsules[0].centre, 2.0, 1.0)
    size = picture.shape[1], picture.shape[0]
    return _before(cv2.warpAffine(picture / _light(empty), turn, size, borderValue=1.0, flags=cv2.INTER_CUBIC), empty)


def salted(picture: Grey, empty: Grey, view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
    """Let one pixel in a hundred be black or white."""
    drawn = random.random(picture.shape)
    return np.where(drawn < 0.005, 0, np.where(drawn > 0.995, 255, picture)).astype(np.uint8), empty


def of_light(levels: Callable[[Floats, Floats], Floats]) -> Fault:
    """Return a fault of the light, given how much there is, 1 if full, and how far from the middle, over l."""

    def changed(picture: Grey, empty: Grey, view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
        y, x = (np.arange(count) - 0.5 * (count - 1) for count in picture.shape)
        away = np.hypot(x, y[:, None]) / HALF_WIDTH
        both = [np.clip(255.0 * levels(grey / 255.0, away), 0, 255).astype(np.uint8) for grey in (picture, empty)]
        return both[0], both[1]

    return changed


def _light(empty: Grey) -> Floats:
    return np.maximum(empty, 1.0)


def _before(transmission: Floats, empty: Grey) -> tuple[Grey, Grey]:
    return np.clip(np.rint(transmission * empty), 0, 255).astype(np.uint8), empty


SQUARED = "levels squared"
STATED = {f"{SQUARED}, and stated": ByHand(gamma=0.5)}
FAULTS: dict[str, Fault] = {
    "a spot of 7 px on the edge": spotted,
    "a smooth bump of 3 px on the rear": bumped,
    "rows read one after the other, 4 px over l": read_by_rows,
    "the capsule askew by 2 degrees": askew,
    **dict.fromkeys((SQUARED, *STATED), of_light(lambda light, away: light**2)),
    "vignetting, a third at 2 l": of_light(lambda light, away: light * (1.0 - away**2 / 12.0)),
    "one pixel in 100 black or white": salted,
}
NAMES = (*CONDITIONS, *FAULTS)


def rows(cases: Database, models: dict[str, Surrogate], number: int) -> dict[str, dict[str, Any]]:
    """Return the answers to one capsule under each condition."""
    shots = dict(taken(cases, number, CONDITIONS, list(OPTICS.values())[number % len(OPTICS)]))
    plain = shots["none"]
    for name, fault in FAULTS.items():
        pictures = fault(plain.picture, plain.empty, plain.view, np.random.default_rng([11, number]))
        shots[name] = Taken(plain.view, *pictures)
    case = int(np.argmin([np.ptp(profile - plain.view.capsules[0].profile) for profile in cases["profile"]]))
    ca, ratio = (float(cases[name][case]) for name in ("capillary_number", "velocity_ratio"))
    errors = np.random.default_rng([3, number])
    return {
        name: answer(shot, ca, ratio, models, errors.standard_normal(2), STATED.get(name))
        for name, shot in sorted(shots.items(), key=lambda item: item[0] in STATED)
    }


def answer(
    shot: Taken, ca: float, ratio: float, models: dict[str, Surrogate], errors: Floats, by_hand: ByHand | None
) -> dict[str, Any]:
    """Measure a picture of a capsule of known Ca and v_o/U and identify it by each way; return why not, if refused.

    `errors` are those of the viscosity and of the velocity, in standard errors.
    """
    picture, empty, by_hand = turned(Picture.from_array(shot.picture), Picture.from_array(shot.empty), by_hand)
    try:
        detection = detect(picture, background=empty, by_hand=by_hand)
    except InputError:
        return {"refused": "the empty channel"}
    modulus = (VISCOSITY.value + VISCOSITY.error * errors[0]) * FLOW / ca
    velocity = FLOW * ratio * (1.0 + OF_VELOCITY * errors[1])
    seen = Quantity(velocity, OF_VELOCITY * FLOW * ratio, "m/s")
    measured = measurement_of(detection, picture, EXPERIMENT, seen)
    if not measured.status.ok:
        return {"refused": measured.status.name}
    away = measured.axial_extent - shot.view.axial_extent / shot.view.half_width
    extent = {f"L_z {level}": int(abs(away) < end * measured.axial_extent_error) for level, end in NORMAL_ENDS.items()}
    truth = {"capillary_number": ca, "surface_shear_modulus": modulus}
    ways = {"silhouette": measured, "lengths": replace(measured, outline=None)}
    if measured.outline is None:
        del ways["silhouette"]
    return extent | {way: told(by, models[way], truth) for way, by in ways.items()}


def told(
    measured: Measurement, model: Surrogate, truth: dict[str, float], experiment: Experiment = EXPERIMENT
) -> dict[str, Any]:
    """Return which intervals hold the true values, the standard deviation and the error of ln G_s, or why not."""
    try:
        found = identify(measured, model, experiment, engine="quadrature", seed=1, error_budget=False)
    except InputError:
        return {"refused": "no such shape"}
    if NOT_TO_BE_USED in found.status.value:
        return {"refused": found.status.name}
    counts = {}
    for name, value in truth.items():
        counts |= held(name, [found[name]], np.array([value]))
    error = float(np.log(found["surface_shear_modulus"].median / truth["surface_shear_modulus"]))
    return {"sd": found.log_modulus_sd, "error": error, **counts}


def summary(answers: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the counts of a condition: of the pictures, and of the answers by each way."""
    found: dict[str, Any] = {"pictures": counts_of(answers, ["L_z"])}
    for way in WAYS:
        used = counts_of([one[way] for one in answers if way in one], list(QUANTITIES))
        rows = [one[way] for one in answers if "sd" in one.get(way, {})]
        medians = (
            {key: float(f"{np.median([one[key] for one in rows]):.3g}") for key in ("sd", "error")} if rows else {}
        )
        found[way] = used | medians
    return found


def counts_of(answers: list[dict[str, Any]], names: list[str]) -> dict[str, Any]:
    """Return how many are refused and why, how many are left, and how many of their intervals hold the truth."""
    used = [one for one in answers if "refused" not in one]
    refused = Counter(one["refused"] for one in answers if "refused" in one)
    keys = [f"{name} {level}" for name in names for level in LEVELS]
    return {"n": len(used), "refused": refused, **{key: sum(one[key] for one in used) for key in keys}}


def tables(stored: dict[str, Any]) -> dict[str, str]:
    """Return the table, a row for each condition."""
    return {"picture moduli": table(HEAD, (_cells(name, found) for name, found in stored.items()))}


def _cells(name: str, found: dict[str, Any]) -> list[str]:
    seen = found["pictures"]
    why = Counter(seen["refused"])
    for way in WAYS:
        why.update({f"{status} ({way})": count for status, count in found[way]["refused"].items()})
    cells = [
        name,
        str(seen["n"]),
        ", ".join(f"{status} {count}" for status, count in why.items()),
        _shares(seen, "L_z"),
    ]
    for way in WAYS:
        counts = found[way]
        medians = f"{counts['sd']:.2g}, {counts['error']:+.2g}" if counts["n"] else ""
        cells += [str(counts["n"]), *(_shares(counts, quantity) for quantity in QUANTITIES), medians]
    return cells


def _shares(counts: dict[str, Any], name: str) -> str:
    return ", ".join(percent(counts[f"{name} {level}"] / counts["n"]) for level in LEVELS) if counts["n"] else ""


STORED = Stored("picture-moduli.json", "evidence/results/pictures.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=10, help="number of capsules (default: 10)")
    parser.add_argument("--keep", type=Path, help="file of the answers, from which an interrupted run goes on")
    given = parser.parse_args()
    cases = read_pool(POOL_FOLDER, "none", 0.0, "development").converged
    models = {way: Surrogate.open("square-neo-hookean", view=view) for way, view in WAYS.items()}
    done = completed(given.keep, ((str(n), partial(rows, cases, models, n)) for n in range(given.count)))
    numbers = {optics: range(first, given.count, len(OPTICS)) for first, optics in enumerate(OPTICS)}
    made = {
        f"all, {optics}": summary([one for n in some for one in done[str(n)].values()])
        for optics, some in numbers.items()
    }
    made |= {name: summary([done[str(n)][name] for n in range(given.count)]) for name in NAMES}
    STORED.show(made, write=given.write)


if __name__ == "__main__":
    main()
