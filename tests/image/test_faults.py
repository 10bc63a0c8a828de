"""What is wrong with a capsule or its picture is refused, or is in the errors of the lengths."""

import cv2
import numpy as np
import pytest

from capsbayes import Database, Experiment
from capsbayes.image import Picture, detect, measure
from capsbayes.status import Status
from evidence.benchmarks.camera import photograph
from evidence.benchmarks.conditions import HALF_WIDTH, scenery

EXPERIMENT = Experiment(cross_section="square", half_width="25.0 +/- 0.001 um", viscosity=0.85)
CAPSULES = range(400, 408)


@pytest.fixture(scope="module")
def scenes():
    """Views of capsules, their pictures and those of the empty channel."""
    cases = Database.open("square-neo-hookean").converged
    views = [scenery(cases, np.random.default_rng([2026, number])) for number in CAPSULES]
    return [(view, *photograph(view, camera, seed=n)) for n, (view, camera) in enumerate(views)]


def spotted(picture, place, radius):
    made = picture.copy()
    cv2.circle(made, tuple(round(float(each)) for each in place), radius, 60, -1, cv2.LINE_AA)
    return made


def sheared(picture, empty, way):
    """As a camera takes it that reads row after row: so many px later at each l further down."""
    rows, columns = np.arange(picture.shape[0]), np.arange(picture.shape[1])
    late, light = way * (rows - rows.mean()) / HALF_WIDTH, picture / empty
    seen = np.array([np.interp(columns - late[row], columns, light[row]) for row in rows])
    return np.clip(seen * empty, 0, 255).astype(np.uint8)


def turned(picture, empty, view, degrees):
    """The capsule alone is turned, in a channel that is not."""
    turn = cv2.getRotationMatrix2D(view.capsules[0].centre, degrees, 1.0)
    light = cv2.warpAffine(picture / empty, turn, picture.shape[::-1], flags=cv2.INTER_CUBIC, borderValue=1.0)
    return np.clip(light * empty, 0, 255).astype(np.uint8)


def nose_of(view):
    points = view.placed(view.capsules[0].silhouette, view.capsules[0])
    return points[np.argmax(points @ view.along)]


def off(scenes, spoiled):
    """Errors of L_z over the stated ones, and the statuses of what is refused."""
    scores, statuses = [], []
    for view, picture, empty in scenes:
        found = measure(spoiled(view, picture, empty), EXPERIMENT, capsule_velocity="6 +/- 0.1 mm/s", background=empty)
        if found.status.ok:
            scores.append((found.axial_extent - view.axial_extent / HALF_WIDTH) / found.axial_extent_error)
        else:
            statuses.append(found.status)
    return np.array(scores), statuses


def test_a_capsule_without_fault_is_measured(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: picture)
    assert not statuses
    assert np.count_nonzero(np.abs(scores) > 1.96) <= 1


def test_dirt_on_the_nose_is_refused(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: spotted(picture, nose_of(view), 3))
    assert len(scores) == 0
    assert set(statuses) == {Status.DOUBLET}


def test_a_capsule_sheared_by_the_shutter_is_refused_or_less_sure(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: sheared(picture, empty, 4.0))
    assert set(statuses) <= {Status.LOPSIDED}
    assert np.abs(scores).max() < 2.5
    scores, statuses = off(scenes, lambda view, picture, empty: sheared(picture, empty, 8.0))
    assert len(scores) == 0
    assert Status.LOPSIDED in statuses


def test_a_capsule_askew_is_less_sure(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: turned(picture, empty, view, 2.0))
    assert len(statuses) <= 1  # next to the walls, which are not turned
    assert np.abs(scores).max() < 2.5


def test_a_particle_inside_is_not_taken_for_the_rear(scenes):
    seen = 0
    for view, picture, empty in scenes:
        behind = np.array(view.capsules[0].centre) - 0.1 * view.axial_extent * view.along
        found = detect(Picture.from_array(spotted(picture, behind, 7)), background=Picture.from_array(empty))
        if found.rear is not None:
            seen += 1
            assert abs(found.lengths[1] - view.axial_length) < 3.0 * np.sqrt(found.covariance[1, 1])
    assert seen >= 2
