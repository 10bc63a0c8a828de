"""Outlines as a microscope has them, against what geometry says."""

import numpy as np
import pytest

from capsbayes.evidence.blind.optics import distorted, enlarged, grown, in_perspective, smeared
from capsbayes.profile import Profile

ANGLE = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
CIRCLE = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


@pytest.fixture
def parachute(square_database):
    """A shape with a deep rear."""
    there = square_database.converged
    return np.array(there["profile"][np.argmax(there["parachute_depth"])])


def test_what_is_grown_is_larger_by_the_distance(parachute):
    seen = Profile.from_outline(grown(CIRCLE, 0.1))
    np.testing.assert_allclose(np.hypot(*seen.points.T), 1.1, atol=1e-4)
    before, after = Profile.from_outline(parachute), Profile.from_outline(grown(parachute, 0.02))
    assert after.axial_extent == pytest.approx(before.axial_extent + 0.04, abs=1e-6)
    assert after.parachute_depth == pytest.approx(before.parachute_depth, abs=1e-4)


def test_smear_covers_what_the_shape_covers_on_its_way(parachute):
    length = 0.05
    before, after = Profile.from_outline(parachute), Profile.from_outline(smeared(parachute, length))
    assert after.axial_extent == pytest.approx(before.axial_extent + length, abs=1e-6)
    assert after.axial_length == pytest.approx(before.axial_length + length, abs=1e-6)
    assert np.ptp(after.points[:, 1]) == pytest.approx(np.ptp(before.points[:, 1]))
    assert smeared(parachute, 0.0) is parachute
    seen = Profile.from_outline(smeared(CIRCLE, 0.2))
    assert seen.area == pytest.approx(Profile.from_outline(CIRCLE).area + 0.4, rel=1e-3)


def test_enlarged_shape_is_similar_and_oblong_pixels_stretch_the_flow_direction_alone(parachute):
    before, after = Profile.from_outline(parachute), Profile.from_outline(enlarged(parachute, 1.03, 1.03))
    assert after.area == pytest.approx(1.03**2 * before.area)
    assert after.axial_length == pytest.approx(1.03 * before.axial_length)
    before, after = Profile.from_outline(parachute), Profile.from_outline(enlarged(parachute, 1.03, 1.0))
    assert after.area == pytest.approx(1.03 * before.area)
    assert np.ptp(after.points[:, 1]) == pytest.approx(np.ptp(before.points[:, 1]))


def test_a_barrel_leaves_the_circle_through_the_walls_and_shortens_what_is_longer():
    np.testing.assert_allclose(np.hypot(*distorted(CIRCLE, -0.02).T), 1.0)
    seen = distorted(CIRCLE * [1.5, 0.5], -0.02)
    assert seen[:, 0].max() == pytest.approx(1.5 * (1.0 - 0.02 * 1.5**2) / 0.98)
    assert seen[:, 1].max() == pytest.approx(0.5 * (1.0 - 0.02 * 0.5**2) / 0.98, rel=1e-4)


def test_straight_lines_stay_straight_in_perspective():
    """A rectangle becomes a trapezoid, broader downstream by the ratio of the distances."""
    corners = np.array([[1.0, 0.5], [-1.0, 0.5], [-1.0, -0.5], [1.0, -0.5]])
    seen = in_perspective(corners, 0.02)
    breadth = [np.ptp(seen[sign * seen[:, 0] > 0.0, 1]) for sign in (1.0, -1.0)]
    assert breadth[0] / breadth[1] == pytest.approx(1.02 / 0.98)
