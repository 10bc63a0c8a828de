"""The microscope of the benchmarks, against capsules whose ends are known and a line in the middle."""

from dataclasses import replace

import numpy as np
import pytest

from evidence.benchmarks import microscope
from evidence.benchmarks.microscope import FINE, Body, imaged, photograph, scenery
from evidence.benchmarks.stored import POOL_FOLDER
from evidence.exam.sessions import read_pool

CASES = read_pool(POOL_FOLDER, "none", 0.0, "development").converged
FLAT = {"band": 0.0, "rear": 0.0, "delay": 0.0, "defocus": 0.0, "down": 0.0, "right": 0.0, "log_photons": 7.0}


def crossings(line, level):
    """Return where a row first and last crosses a level."""
    first, last = np.flatnonzero(line > level)[[0, -1]]
    start = first - (line[first] - level) / (line[first] - line[first - 1])
    return start, last + (line[last] - level) / (line[last] - line[last + 1])


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_flat_capsule_is_dark_from_end_to_end_of_its_silhouette(monkeypatch, number):
    monkeypatch.setattr(microscope, "NOISE", 0.0)
    _, view, random = scenery(CASES, "in focus, incoherent", number)
    view = replace(view, tilt=0.0, flow=1, middle=(0.3, 0.1), values=view.values | FLAT)
    picture, empty = (grey.astype(float) for grey in photograph(view, random))
    off = np.arange(view.shape[0]) - 0.5 * (view.shape[0] - 1) - view.middle[1]
    level = 0.5 * view.values["inside"]
    dark = (1.0 - picture / empty)[np.abs(off) < 0.9 * view.half_width]
    left, right = np.transpose([crossings(line, level) for line in dark if line.max() > 1.5 * level])
    place = 0.5 * (view.shape[1] - 1) + view.middle[0]
    half_length = 0.5 * view.half_width * np.ptp(view.silhouette[:, 0])
    assert left.min() == pytest.approx(place - half_length, abs=0.15)
    assert right.max() == pytest.approx(place + half_length, abs=0.15)


@pytest.mark.parametrize("case", [0, 100, 300, 599])
def test_a_body_ends_where_its_silhouette_does(case):
    body, rear = Body(CASES["silhouette"][case], CASES["profile"][case]), CASES["silhouette"][case][128:100:-1]
    z = np.linspace(-1.5, 0.0, 1501)
    for height in np.linspace(0.0, 0.8 * body.rim[1], 9):
        first = z[body.chord(z, np.full(len(z), height)) > 0.0].min()
        assert first == pytest.approx(np.interp(height, rear[:, 1], rear[:, 0]), abs=6e-3)


@pytest.mark.parametrize("condenser", [0.15, 0.4])
def test_a_line_in_the_middle_is_seen_in_the_middle(condenser):
    values = {"aperture": 0.4, "condenser": condenser, "defocus": 0.0}
    field = np.ones((40 * FINE, 52 * FINE))
    even = imaged(field, 0.5, values)
    field[:, 26 * FINE - 1 : 26 * FINE + 1] = 0.9
    line = (even - imaged(field, 0.5, values)).mean(axis=0)
    assert set(np.argsort(line)[-2:]) == {25, 26}
    np.testing.assert_allclose(line, line[::-1], atol=1e-3 * line.max())


def test_a_picture_depends_on_condition_and_number_alone():
    first, again = (photograph(*scenery(CASES, "mild rings", 3)[1:])[0] for _ in range(2))
    np.testing.assert_array_equal(first, again)
