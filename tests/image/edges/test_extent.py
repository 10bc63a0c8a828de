"""The furthest point of an ellipse, whose distance and error are known."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from known_outlines import ellipse, noisy
from scipy.signal import savgol_coeffs

from capsbayes.image.edges import furthest_point


@pytest.mark.parametrize(("a", "b"), [(30.0, 30.0), (40.0, 20.0), (20.0, 40.0)])
@pytest.mark.parametrize("tilt", [0.0, 0.7, 3.0])
def test_it_is_the_end_of_an_axis_however_the_ellipse_lies(a, b, tilt):
    direction = np.array([np.cos(tilt), np.sin(tilt)])
    outline = ellipse(a, b, tilt=tilt)
    found = furthest_point(outline, direction, 0.0)
    assert found.distance == pytest.approx(direction @ [40.0, 30.0] + a, abs=0.01)
    there = furthest_point(outline, -direction, 0.0)
    assert found.distance + there.distance == pytest.approx(2.0 * a, abs=0.02)


@pytest.mark.parametrize(("point", "shared"), [(0.2, 0.0), (0.0, 0.15)])
def test_its_error_is_the_scatter_of_outlines_with_such_errors(point, shared):
    outline = ellipse(30.0, 28.0, point=point, shared=shared, arcs=20)
    rng, along = np.random.default_rng(3), np.array([1.0, 0.0])
    found = [
        furthest_point(replace(outline, points=noisy(outline, rng, within_arcs=False)), along, 0.0) for _ in range(400)
    ]
    assert np.mean([one.distance for one in found]) == pytest.approx(70.0, abs=0.1)
    stated = np.mean([one.variance - one.systematic for one in found])
    assert np.var([one.distance for one in found]) == pytest.approx(stated, rel=0.3)


def test_errors_that_are_larger_than_stated_widen_it():
    outline = ellipse(30.0, 28.0, point=0.05)
    along, rng = np.array([1.0, 0.0]), np.random.default_rng(4)
    found = []
    for _ in range(200):
        points = noisy(replace(outline, point_error=np.full(240, 0.4)), rng, within_arcs=False)
        found.append(furthest_point(replace(outline, points=points), along, 0.0))
    stated = np.mean([one.variance - one.systematic for one in found])
    assert np.var([one.distance for one in found]) == pytest.approx(stated, rel=0.4)


def test_what_all_pictures_share_is_the_floor_and_the_misfit_of_the_model():
    """The first term that the model lacks grows with the square of the edge's width."""
    along = np.array([1.0, 0.0])
    sharp, blurred = (furthest_point(ellipse(30.0, 30.0, width=width), along, 0.02) for width in (1.0, 3.0))
    assert sharp.systematic == pytest.approx(0.02**2 + 0.03**2)
    assert blurred.systematic == pytest.approx(0.18**2 + 0.03**2)
    assert sharp.variance >= sharp.systematic
    own = [
        one.variance - one.systematic
        for one in (furthest_point(ellipse(30.0, 30.0, width=width), along, 0.5) for width in (2.0, 4.0))
    ]
    assert own[1] == pytest.approx(16.0 * own[0], rel=0.01)


def test_next_to_a_sharp_tip_few_points_count():
    """An ellipse twelve times as long as it is broad is no quartic over many points."""
    found = furthest_point(ellipse(60.0, 5.0, point=0.02), np.array([1.0, 0.0]), 0.0)
    assert found.distance == pytest.approx(100.0, abs=0.06)


def parabola(bend=0.01, top=0.0, error=0.1):
    """Outline whose distances along x are a parabola of the number of the point, highest at 120 and a part of one."""
    outline, number = ellipse(30.0, 30.0, point=error), np.arange(240.0) - 120.0 - top
    return replace(outline, points=np.stack([70.0 - bend * number**2, number], axis=1))


@pytest.mark.parametrize(("misfit", "kept"), [(1.54, 15), (1.66, 10)])
def test_a_neighbourhood_is_used_if_the_quartic_agrees_with_its_points_to_within_their_errors(misfit, kept):
    """Errors beyond ten points from the top, in turn out and in, are no quartic; the rest is one exactly.

    The variance of a quartic in its middle is the sum of the squares of the weights of Savitzky and Golay.
    """
    outline, error = parabola(), np.hypot(0.1, 0.03)
    outer = np.abs(np.arange(240) - 120)
    turn = np.where((outer > 10) & (outer <= 15), error * (-1.0) ** np.arange(240), 0.0)
    t = np.arange(-15, 16)
    left = turn[105:136] - np.polynomial.Polynomial.fit(t, turn[105:136], 4)(t)
    turn *= error * np.sqrt(misfit * 26.0) / np.sqrt(left @ left)
    outline = replace(outline, points=outline.points + turn[:, None] * np.array([1.0, 0.0]))
    found = furthest_point(outline, np.array([1.0, 0.0]), 0.0)
    student = scipy.stats.t.ppf(0.975, 26) / scipy.stats.norm.ppf(0.975)
    own = error**2 * np.sum(savgol_coeffs(2 * kept + 1, 4) ** 2) * (misfit * student**2 if kept == 15 else 1.0)
    assert found.variance - found.systematic == pytest.approx(own, rel=0.05)


@pytest.mark.parametrize("top", [-0.3, 0.3])
def test_the_width_of_the_edge_is_that_at_the_furthest_point(top):
    outline = replace(parabola(top=top), edge_width=1.0 + 0.05 * np.abs(np.arange(240) - 120))
    found = furthest_point(outline, np.array([1.0, 0.0]), 0.1)
    assert found.systematic == pytest.approx(0.1**2 + 0.03**2)
