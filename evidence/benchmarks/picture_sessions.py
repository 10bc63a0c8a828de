"""Sessions drawn as pictures, measured and diagnosed: what is hidden is in the shapes, the camera or the light.

    python -m evidence.benchmarks.picture_sessions --sessions 3 --write

Diagnoses the sessions of each row that have no answer in ``evidence/results/picture-sessions.json`` yet, half a minute
each, and prints the table of all answers. ``--write`` renews the table in ``evidence/results/diagnosis.md``, where the
sessions are described.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes import Quantity, Surrogate, diagnose
from capsbayes.database import Database
from capsbayes.diagnosis import Session
from capsbayes.diagnosis.blind import TRUE_EFFECTS, BlindSession, draw_session
from capsbayes.experiment import Experiment
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measurement_of
from capsbayes.measurement import Measurement
from evidence.benchmarks.camera import Camera, Capsule, Grey, Looks, View, photograph
from evidence.benchmarks.conditions import HALF_WIDTH, MARGIN, drawn_camera, drawn_looks
from evidence.benchmarks.hidden_sessions import PAGE, answer_of, diagnosed, outcomes
from evidence.benchmarks.stored import POOL_FOLDER, Stored
from evidence.exam.sessions import drawn_lab

MIDDLE = 4e-3  # m/s, velocity of a capsule at which motion in the exposure is stated

Seen = Callable[[View, Camera, float], tuple[View, Camera]]


class Row(NamedTuple):
    """What is hidden: shapes of a pool, what changes the view or the camera at a velocity [m/s], and the lens.

    `truth` are the names that the catalogue has for it.
    """

    hidden: str
    truth: tuple[str, ...] = ()
    pool: str = "none-0"
    seen: Seen = lambda view, camera, velocity: (view, camera)
    barrel: float = 0.0


def _camera(**changes: Any) -> Seen:
    return lambda view, camera, velocity: (view, replace(camera, **changes))


def _looks(**changes: float) -> Seen:
    return lambda view, camera, velocity: (replace(view, looks=replace(view.looks, **changes)), camera)


def _moving(share: float) -> Seen:
    """Let capsules move during the exposure: by a share of l at `MIDDLE`."""
    return lambda view, camera, velocity: (view, replace(camera, motion=share * HALF_WIDTH * velocity / MIDDLE))


def _oblong(aspect: float) -> Seen:
    """Stretch capsules along the channel, which is nearly along the rows."""

    def seen(view: View, camera: Camera, velocity: float) -> tuple[View, Camera]:
        capsule = view.capsules[0]
        longer = replace(
            capsule, profile=capsule.profile * [aspect, 1.0], silhouette=capsule.silhouette * [aspect, 1.0]
        )
        return replace(view, capsules=(longer,)), camera

    return seen


ROWS = (
    Row("nothing"),
    Row("inflation of 3.5 %", ("pre_inflation",), "pre-inflation-0.035"),
    Row("hardening of 0.8", ("strain_hardening",), "strain-hardening-0.8"),
    Row("at rest 7.5 % flatter than a sphere", ("rest_aspect",), "rest-aspect-0.925"),
    Row("channel 7.5 % deeper than wide", ("section_aspect",), "section-aspect-1.075"),
    Row("pixels 4 % oblong", ("pixel_aspect",), seen=_oblong(1.04)),
    Row("barrel, 1 %", ("distortion",), barrel=-0.01),
    Row("motion of 0.03 l", ("exposure",), seen=_moving(0.03)),
    Row("membrane of generalised Hooke's law", ("hooke_share",), "hooke-share-1"),
    Row("bright halo of 15 %", seen=_looks(halo=0.15)),
    Row("out of focus, disc of radius 3 px", seen=_camera(defocus=3.0)),
    Row("noise of 5 %", seen=_camera(constant_noise=0.05)),
    Row("JPEG 50", seen=_camera(jpeg=50)),
)


def answered(row: Row, seed: int, model: Surrogate) -> dict[str, Any]:
    """Draw a session and its pictures, measure and diagnose it, and return the answer next to the truth."""
    begin = time.process_time()
    blind, pictures = taken(row, seed)
    measurements = [measured(*pictured, blind.lab.experiment) for pictured in pictures]
    done = [measurement for measurement in measurements if measurement.status.ok]
    study = diagnose(Session(done, blind.lab.experiment), model, seed=seed)
    true = float(np.exp(np.median(blind.log_modulus)))
    return answer_of(study, true, begin) | {"capsules": len(pictures), "measured": len(done)}


def taken(row: Row, seed: int) -> tuple[BlindSession, list[tuple[Grey, Grey, Quantity]]]:
    """Return a session, and of each capsule the picture, that of the empty channel, and the velocity [m/s]."""
    random = np.random.default_rng([seed, *row.hidden.encode()])
    lab, count = drawn_lab(random)
    shapes = Database.read(POOL_FOLDER / f"{row.pool}.nc").converged
    blind = draw_session(shapes, TRUE_EFFECTS["none"], 0.0, lab=lab, capsules=count, seed=int(random.integers(2**31)))
    looks, camera = drawn_looks(random), drawn_camera(random)
    flow, tilt = int(random.choice([-1, 1])), random.uniform(-0.03, 0.03)
    pictures = []
    for capsule, seen in zip(blind.capsules, blind.session.measurements, strict=True):
        profile, silhouette = (shapes[name][capsule.row] for name in ("profile", "silhouette"))
        view = _view(profile, silhouette, looks, random, flow, tilt)
        shown = photograph(*row.seen(view, camera, capsule.capsule_velocity), seed=int(random.integers(2**31)))
        picture, empty = (bent(grey, row.barrel) for grey in shown)
        assert seen.capsule_velocity is not None
        pictures.append((picture, empty, Quantity(seen.capsule_velocity, seen.capsule_velocity_error)))
    return blind, pictures


def _view(
    profile: NDArray[np.float64],
    silhouette: NDArray[np.float64],
    looks: Looks,
    random: np.random.Generator,
    flow: int,
    tilt: float,
) -> View:
    columns = max(int(1.05 * HALF_WIDTH * np.ptp(silhouette[:, 0]) + 2.0 * MARGIN + 24), 200)
    centre = 0.5 * columns + random.uniform(-4.0, 4.0), 99.5 + random.uniform(-4.0, 4.0)
    return View((Capsule(profile, silhouette, centre),), HALF_WIDTH, (200, columns), tilt=tilt, flow=flow, looks=looks)


def bent(picture: Grey, barrel: float) -> Grey:
    """Return a picture through a lens that moves what is at l from the middle by a share of l: a barrel's is < 0."""
    if not barrel:
        return picture
    rows, columns = picture.shape
    y, x = np.mgrid[:rows, :columns].astype(float)
    middle_x, middle_y = 0.5 * (columns - 1), 0.5 * (rows - 1)
    shown = np.hypot(x - middle_x, y - middle_y) / HALF_WIDTH
    true = shown.copy()
    for _ in range(20):  # of shown = true (1 + barrel true^2), by iteration
        true = shown / (1.0 + barrel * true**2)
    factor = np.divide(true, shown, out=np.ones_like(shown), where=shown > 0.0)
    from_x, from_y = middle_x + factor * (x - middle_x), middle_y + factor * (y - middle_y)
    places = from_x.astype(np.float32), from_y.astype(np.float32)
    return np.asarray(cv2.remap(picture, *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def measured(picture: Grey, empty: Grey, velocity: Quantity, experiment: Experiment) -> Measurement:
    """Return what is measured in a picture."""
    whole = Picture.from_array(picture)
    return measurement_of(detect(whole, background=Picture.from_array(empty)), whole, experiment, velocity)


STORED = Stored("picture-sessions.json", PAGE, lambda answers: {"picture sessions": outcomes(ROWS, answers)})

if __name__ == "__main__":
    diagnosed(__doc__, ROWS, STORED, answered, view="silhouette")
