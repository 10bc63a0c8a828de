"""Compiled loops over profiles, compared with the same by numpy and scipy."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter

from capsbayes.image.edge_models import (
    curvatures,
    mean_squares,
    means_of_arcs,
    misfit_around,
    rounded,
    sampled,
    tangents,
)

RANDOM = np.random.default_rng(3)
ANGLE = 2.0 * np.pi * np.arange(90) / 90
CIRCLE = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


@pytest.mark.parametrize(("radius", "beyond"), [(11.0, False), (18.0, True)])
def test_a_picture_is_sampled_as_by_scipy_and_beyond_its_borders_as_there(radius, beyond):
    light, last = RANDOM.uniform(size=(30, 37)), np.array([29.0, 36.0])[:, None, None]
    points, distances = np.array([17.3, 15.1]) + radius * CIRCLE, np.arange(-2.0, 3.0)
    at = points.T[::-1, :, None] - distances * CIRCLE.T[::-1, :, None]
    assert np.any((at < 0.0) | (at > last)) == beyond
    expected = map_coordinates(light, np.clip(at, 0.0, last), order=3, mode="mirror")
    spline = spline_filter(light, order=3, mode="mirror")
    np.testing.assert_allclose(sampled(spline, points, CIRCLE, distances), expected, atol=1e-12)


def test_means_and_mean_squares_are_those_of_the_profiles_of_an_arc():
    profiles, arc = RANDOM.uniform(size=(20, 7)), np.arange(20) * 3 // 20
    used = np.array([[1, 1, 1, 1, 1, 1, 1], [0, 1, 1, 1, 1, 0, 0], [0, 0, 0, 1, 0, 0, 0]], dtype=float)
    means, count = means_of_arcs(profiles, arc, 3)
    for number in range(3):
        np.testing.assert_allclose(means[number], profiles[arc == number].mean(axis=0))
    np.testing.assert_array_equal(count, [7, 7, 6])
    squares = (profiles - means[arc]) ** 2
    expected = [row[kept > 0.0].mean() for row, kept in zip(squares, used[arc], strict=True)]
    np.testing.assert_allclose(mean_squares(profiles, means, arc, used), expected)


def test_the_misfit_of_an_arc_is_that_of_its_neighbours_too_around_the_curve():
    left, used, variance = RANDOM.uniform(size=(9, 8)), np.ones((9, 8)), RANDOM.uniform(1.0, 2.0, 9)
    used[3] = [1, 1, 0, 0, 0, 0, 0, 0]  # less than what is fitted: no degree of freedom
    squares, free = np.sum(used * left**2, axis=1), np.where(np.arange(9) == 3, 0.0, 3.0)
    around = [np.arange(number - 2, number + 3) % 9 for number in range(9)]
    expected = [np.sqrt(squares[n].sum() / free[n].sum() * v) for n, v in zip(around, variance, strict=True)]
    np.testing.assert_allclose(misfit_around(left, used, variance, 5.0, 2), expected)


def test_tangents_and_curvature_are_those_of_a_circle():
    circle = 20.0 * CIRCLE + 3.0
    np.testing.assert_allclose(tangents(circle), np.stack([-np.sin(ANGLE), np.cos(ANGLE)], axis=1), atol=1e-12)
    np.testing.assert_allclose(curvatures(circle), 1.0 / 20.0, rtol=3e-3)
    np.testing.assert_allclose(curvatures(circle[::-1]), -1.0 / 20.0, rtol=3e-3)


def test_waves_of_a_curve_are_smoothed_by_a_gaussian():
    waves = np.stack([np.cos(6.0 * ANGLE), np.sin(11.0 * ANGLE)], axis=1)
    factors = np.exp(-0.5 * (2.0 * 2.0 * np.pi * np.array([6.0, 11.0]) / 90.0) ** 2)
    np.testing.assert_allclose(rounded(waves, 2.0), factors * waves, atol=2e-4)
