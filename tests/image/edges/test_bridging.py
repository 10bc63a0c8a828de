"""Erased stretches of closed curves."""

import numpy as np
import pytest

from capsbayes.image.edge_models import bridge_errors, bridged, within

RADIUS, COUNT = 40.0, 200


def circle(start=0.0):
    angle = start + 2.0 * np.pi * np.arange(COUNT) / COUNT
    return RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("start", [0.0, 0.4, 3.0])
@pytest.mark.parametrize("half", [5.0, 20.0])
def test_the_bridge_of_a_circle_lies_on_the_circle(start, half):
    curve = circle(start)
    erased = within(curve, np.array([[RADIUS - 15.0, -half, RADIUS + 15.0, half]]))
    points, bridge = bridged(curve, erased)
    np.testing.assert_allclose(np.hypot(*points.T), RADIUS, atol=0.02 if half < 10.0 else 0.2)
    assert np.abs(points[bridge, 1]).max() < half + 1.3
    apart = np.abs(points[~bridge, None] - curve).sum(axis=2).min(axis=1)
    assert np.all(apart == 0.0)
    assert len(apart) == np.count_nonzero(~erased)
    assert np.hypot(*np.diff(points, axis=0, append=points[:1]).T).max() < 1.6


def test_two_stretches_are_bridged_each():
    boxes = np.array([[30.0, -10.0, 50.0, 10.0], [-50.0, -10.0, -30.0, 10.0]])
    points, bridge = bridged(circle(), within(circle(), boxes))
    assert np.count_nonzero(bridge & ~np.roll(bridge, 1)) == 2
    np.testing.assert_allclose(np.hypot(*points.T), RADIUS, atol=0.1)


def test_a_curve_of_which_nothing_is_erased_stays_and_one_of_which_little_is_left_is_none():
    points, bridge = bridged(circle(), np.zeros(COUNT, dtype=bool))
    np.testing.assert_array_equal(points, circle())
    assert not bridge.any()
    assert bridged(circle(), np.arange(COUNT) > 30) is None


def test_the_error_of_a_bridge_grows_with_its_height_and_is_zero_elsewhere():
    short, long = (np.abs(circle()[:, 1]) < half for half in (6.0, 20.0))
    short &= circle()[:, 0] > 0.0
    long &= circle()[:, 0] > 0.0
    few, many = (bridge_errors(circle(), erased) for erased in (short, long))
    assert np.all(few[~short] == 0.0)
    height = RADIUS - np.sqrt(RADIUS**2 - 20.0**2)
    assert many[long] == pytest.approx(np.hypot(0.25, height), rel=0.15)
    assert np.all((few[short] > 0.25) & (few[short] < 0.2 * many[long].max()))
