"""The edge of a dark disc in a picture without walls."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq
from scipy.stats import norm

from capsbayes.image.edges import _blur_at, averaged, locate_edge, pixel_noise, thinned

RADIUS, CENTRE, FINE = 20.0, np.array([34.3, 31.8]), 5


def disc(blur=1.2, noise=0.0, seed=1, dark=0.4):
    """Light of a disc (rows, columns), drawn on pixels five times finer and blurred there; a blur may be (x, y)."""
    fine = (np.arange(68 * FINE) + 0.5) / FINE - 0.5
    inside = np.hypot(fine - CENTRE[0], fine[: 64 * FINE, None] - CENTRE[1]) < RADIUS
    light = gaussian_filter(1.0 - dark * inside, FINE * np.broadcast_to(blur, 2)[::-1], mode="nearest")
    light = light.reshape(64, FINE, 68, FINE).mean(axis=(1, 3))
    return light + noise * np.random.default_rng(seed).standard_normal(light.shape)


def polygon(radius=RADIUS + 0.7, count=60):
    angle = 2.0 * np.pi * np.arange(count) / count
    return CENTRE + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def off(outline):
    return np.hypot(*(outline.points - CENTRE).T) - RADIUS


@pytest.mark.parametrize("blur", [0.8, 1.2, 2.5])
def test_the_edge_of_a_disc_is_its_circle_with_the_width_of_the_blur(blur):
    outline = locate_edge(disc(blur), polygon(), 1e-3)
    assert np.sqrt(np.mean(off(outline) ** 2)) < 0.04
    assert abs(off(outline).mean()) < 0.015
    assert np.median(outline.edge_width) == pytest.approx(np.hypot(blur, 1.0 / np.sqrt(12.0)), rel=0.05)
    outward = (outline.points - CENTRE) / np.hypot(*(outline.points - CENTRE).T)[:, None]
    assert np.sum(outward * outline.normals, axis=1).min() > 0.99
    steps = np.hypot(*np.diff(outline.points, axis=0).T)
    assert 1.0 < steps.min() <= steps.max() < 1.6
    assert np.all(np.diff(outline.arc) >= 0)
    assert 12.0 < 2.0 * np.pi * RADIUS / (outline.arc[-1] + 1) < 24.0


@pytest.mark.parametrize("blur", [(2.0, 1.0), (1.0, 2.0)])
def test_a_blur_in_one_direction_leaves_the_circle_where_it_is(blur):
    """The width changes within each arc, and the shift by the blur along the edge from arc to arc."""
    outline = locate_edge(disc(blur), polygon(), 1e-3)
    assert np.sqrt(np.mean(off(outline) ** 2)) < 0.13
    assert np.abs(off(outline)).max() < 0.25
    for axis in (0, 1):
        facing = np.abs(outline.normals[:, axis]) > 0.95
        assert np.median(outline.edge_width[facing]) == pytest.approx(blur[axis], rel=0.3)


@pytest.mark.parametrize(("x", "y"), [(2.0, 1.0), (1.0, 2.0), (1.5, 1.5)])
def test_the_blur_along_the_edge_says_where_half_the_light_is(x, y):
    """A parabolic edge seen through a Gaussian blur, by quadrature, with its normal at any angle."""
    angle, bend = np.array([0.0, 0.8, np.pi / 2.0, 4.0]), 0.02
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tangents = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    covariance = np.diag([x**2, y**2])
    widths = np.sqrt(np.einsum("ni,ij,nj->n", normals, covariance, normals))
    across, along = _blur_at(widths, normals)
    np.testing.assert_allclose(across, widths)
    for normal, tangent, width in zip(normals, tangents, along, strict=True):
        spread = np.sqrt(tangent @ covariance @ tangent)
        slope = normal @ covariance @ tangent / spread**2
        rest = np.sqrt(normal @ covariance @ normal - (slope * spread) ** 2)

        def light(place, spread=spread, slope=slope, rest=rest):
            def inside(t):
                return norm.pdf(t, scale=spread) * norm.cdf((-place - 0.5 * bend * t**2 - slope * t) / rest)

            return quad(inside, -8.0 * spread, 8.0 * spread)[0] - 0.5

        assert -brentq(light, -0.5, 0.5) == pytest.approx(0.5 * bend * width**2, rel=0.03)


def test_the_outline_moves_with_the_capsule_through_the_picture():
    here, shift = locate_edge(disc(), polygon(), 1e-3), np.array([40.0, 50.0])
    there = locate_edge(np.pad(disc(), ((50, 10), (40, 20)), mode="edge"), polygon() + shift, 1e-3)
    np.testing.assert_allclose(there.points, here.points + shift, atol=1e-3)


def test_errors_of_the_points_are_the_scatter_of_noisy_pictures():
    noise = 0.01
    places, stated, shared = [], [], []
    for seed in range(20):
        outline = locate_edge(disc(noise=noise, seed=seed), polygon(), noise)
        at = off(outline)
        means = np.array([at[outline.arc == arc].mean() for arc in range(outline.arc[-1] + 1)])
        places.append(np.var(at - means[outline.arc]))
        shared.append((np.var(means), np.mean(outline.arc_error**2)))
        stated.append(np.mean(outline.point_error**2))
    assert np.mean(places) == pytest.approx(np.mean(stated), rel=0.35)
    scatter, expected = np.mean(shared, axis=0)
    assert scatter == pytest.approx(expected, rel=0.6)


def test_twice_the_noise_is_twice_the_error():
    one, two = (locate_edge(disc(), polygon(), noise) for noise in (0.01, 0.02))
    np.testing.assert_allclose(two.point_error, 2.0 * one.point_error)
    np.testing.assert_allclose(two.arc_error, 2.0 * one.arc_error)


def test_a_picture_without_a_jump_has_no_edge():
    noise = 0.01 * np.random.default_rng(1).standard_normal((64, 68))
    assert locate_edge(1.0 + noise, polygon(), 0.01) is None
    assert locate_edge(2.0 - disc(), polygon(), 0.01) is None  # brighter inside


@pytest.mark.parametrize(("dark", "seen"), [(0.036, True), (0.024, False)])
def test_a_jump_by_less_than_three_hundredths_of_the_light_is_no_edge(dark, seen):
    assert (locate_edge(disc(dark=dark), polygon(), 1e-4) is not None) == seen


def test_where_there_is_no_edge_the_outline_follows_its_neighbours_with_an_error_of_a_third_of_a_pixel():
    """The disc fades to the right; the curve given there is 0.7 px outside of it."""
    y, x = np.mgrid[:64, :68]
    away = np.abs(np.arctan2(y - CENTRE[1], x - CENTRE[0]))
    outline = locate_edge(1.0 - (1.0 - disc()) * np.clip((away - 0.8) / 0.3, 0.0, 1.0), polygon(), 1e-3)
    angle = np.abs(np.arctan2(*(outline.points - CENTRE).T[::-1]))
    assert np.abs(off(outline)[angle < 0.3]).max() < 0.3
    np.testing.assert_allclose(outline.arc_error[angle < 0.3], 0.3)
    assert not outline.located[angle < 0.3].any()
    assert outline.located[angle > 1.6].all()
    assert np.abs(off(outline)[angle > 1.6]).max() < 0.1
    assert outline.arc_error[angle > 1.6].max() < 0.05


def test_the_noise_of_a_pixel_is_found_next_to_slopes_and_shapes():
    assert pixel_noise(disc(noise=0.02)) == pytest.approx(0.02, rel=0.08)
    slope = 0.05 * np.arange(300.0) + 0.02 * np.random.default_rng(2).standard_normal((200, 300))
    assert pixel_noise(slope) == pytest.approx(0.02, rel=0.03)
    assert pixel_noise(np.ones((20, 20))) == 1e-6
    wide = np.random.default_rng(2).normal(1.0, 0.02, (60, 50_000))  # a row holds more pixels than are asked for
    assert pixel_noise(wide) == pytest.approx(0.02, rel=0.03)


def test_means_of_three_points_lie_on_the_curve_through_them():
    """At the tips of an ellipse, of radius 7 px, means lie within it by a twentieth of a pixel."""
    angle = np.linspace(0.0, 2.0 * np.pi, 4001)
    fine = np.stack([60.0 * np.cos(angle), 20.0 * np.sin(angle)], axis=1)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    places = np.arange(216) * arc[-1] / 216
    points = np.stack([np.interp(places, arc, column) for column in fine.T], axis=1)
    off_means, off = (
        np.hypot(made[:, 0] / 60.0, made[:, 1] / 20.0) - 1.0 for made in (averaged(points), thinned(points))
    )
    assert np.abs(off_means).max() * 60.0 > 0.05
    assert np.abs(off).max() < 0.2 * np.abs(off_means).max()
    assert len(thinned(points[:-1])) == len(points) // 3 - 1
