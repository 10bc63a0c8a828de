"""The located outline, its ends, its rear and its integrals."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from drawn import HALF_WIDTH, circle, drawn
from known_outlines import ellipse, noisy
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.optimize import brentq
from scipy.signal import savgol_coeffs
from scipy.special import ellipe
from scipy.stats import norm

from capsbayes.image.edges import (
    _CURVATURES,
    EDGE_FLOOR,
    _blur_at,
    _coarse,
    averaged,
    centroid,
    centroid_variance,
    find_rear,
    furthest_point,
    integrate_silhouette,
    locate_edge,
    pixel_noise,
    thinned,
)
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.image.synthetic import Optics, Scene, draw
from capsbayes.profile import Profile

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


def seen(made):
    return detect(Picture.from_array(made.picture), background=Picture.from_array(made.background))


def test_a_disc_is_a_sphere_seen_from_the_side():
    radius = 0.8 * HALF_WIDTH
    found = seen(draw(Scene(circle(0.8), circle(0.8), half_width=HALF_WIDTH), Optics(), seed=2)).integrals
    truth = {
        "area": np.pi * radius**2,
        "perimeter": 2.0 * np.pi * radius,
        "volume": 4.0 / 3.0 * np.pi * radius**3,
        "stretch_ratio": 1.0,
    }
    for name, value in truth.items():
        one = getattr(found, name)
        assert abs(one.value - value) < 2.5 * one.error, name
        assert one.error < 0.006 * value, name


def test_of_a_capsule_it_is_the_silhouette():
    made = drawn(0.05, 0.8)
    found = seen(made).integrals
    outline = Profile.from_outline(HALF_WIDTH * np.asarray(made.scene.silhouette))
    assert found.area.value == pytest.approx(outline.area, abs=2.5 * found.area.error)
    assert found.perimeter.value == pytest.approx(outline.perimeter, abs=2.5 * found.perimeter.error)


def test_the_centroid_scatters_as_it_says():
    scenes = [draw(Scene(circle(0.8), circle(0.8), 30.0, (90, 90)), Optics(electrons=2000), seed=s) for s in range(20)]
    along = np.array([1.0, 0.0])
    outlines = [seen(made).outline for made in scenes]
    places = [centroid(outline.points)[0] for outline in outlines]
    expected = np.sqrt(np.mean([centroid_variance(outline, along) for outline in outlines]))
    assert np.mean(places) == pytest.approx(44.5, abs=0.02)
    assert 0.4 * expected < np.std(places) < 1.4 * expected


AXIS, ACROSS = np.array([40.0, 30.0]), np.array([0.0, 1.0])
NAMES = ("area", "perimeter", "volume", "stretch_ratio")


def of_ellipse(a, b):
    """Area and perimeter of an ellipse, and volume and stretch ratio of the spheroid about the axis along a."""
    perimeter, sphere = 4.0 * a * ellipe(1.0 - (b / a) ** 2), (a * b * b) ** (1.0 / 3.0)
    return np.pi * a * b, perimeter, 4.0 / 3.0 * np.pi * a * b * b, perimeter / (2.0 * np.pi * sphere)


@pytest.mark.parametrize(("a", "b"), [(30.0, 30.0), (40.0, 25.0), (25.0, 35.0)])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_of_a_spheroid_they_are_the_closed_forms(a, b, tilt):
    across = np.array([-np.sin(tilt), np.cos(tilt)])
    found = integrate_silhouette(ellipse(a, b, tilt=tilt, count=400), AXIS + 5.0 * across[::-1] * [1, -1], across, 0.0)
    for name, value in zip(NAMES, of_ellipse(a, b), strict=True):
        assert getattr(found, name).value == pytest.approx(value, rel=3e-4), name


def test_of_two_unlike_halves_the_volume_is_the_mean():
    """An axis off the middle cuts a circle into two unlike caps."""
    radius, aside = 30.0, 6.0
    found = integrate_silhouette(ellipse(radius, radius, count=4000), AXIS + aside * ACROSS, ACROSS, 0.0)

    def body(sign):
        angle = np.linspace(0.0, 2.0 * np.pi, 200_001)
        y = np.maximum(sign * (radius * np.sin(angle) - aside), 0.0)
        x = radius * np.cos(angle)
        return abs(np.sum(0.5 * np.pi * (y[1:] ** 2 + y[:-1] ** 2) * np.diff(x)))

    assert found.volume.value == pytest.approx(0.5 * (body(1.0) + body(-1.0)), rel=2e-3)


@pytest.mark.parametrize(("point", "shared"), [(0.05, 0.0), (0.0, 0.3)])
def test_their_errors_are_the_scatter_of_outlines_with_such_errors(point, shared):
    outline = ellipse(40.0, 25.0, point=point, shared=shared, count=200, arcs=10)
    rng = np.random.default_rng(6)
    found = [integrate_silhouette(replace(outline, points=noisy(outline, rng)), AXIS, ACROSS, 0.0) for _ in range(200)]
    stated = integrate_silhouette(outline, AXIS, ACROSS, 0.0)
    least = integrate_silhouette(ellipse(40.0, 25.0, count=200, arcs=10), AXIS, ACROSS, 0.0)
    for name in NAMES:
        scatter = np.std([getattr(one, name).value for one in found])
        own = np.sqrt(getattr(stated, name).error ** 2 - getattr(least, name).error ** 2)
        assert 0.85 * scatter < own < 1.15 * scatter + 1e-4 * getattr(stated, name).value, name


def test_an_edge_that_is_everywhere_too_far_out_changes_them_by_their_errors():
    """By the misfit times the square of the width of the edge, or by the floor if that is more."""
    radius, width, misfit = 30.0, 3.0, 0.05
    found = integrate_silhouette(ellipse(radius, radius, width=width, count=400), AXIS, ACROSS, misfit)
    out = np.hypot(misfit * width**2, EDGE_FLOOR)
    assert found.area.error == pytest.approx(2.0 * np.pi * radius * out, rel=0.01)
    assert found.perimeter.error == pytest.approx(2.0 * np.pi * out, rel=0.01)
    assert found.volume.error == pytest.approx(4.0 * np.pi * radius**2 * out, rel=0.01)
    assert found.stretch_ratio.error < 0.02 * out / radius


def test_noise_of_the_points_does_not_lengthen_the_perimeter():
    outline = ellipse(30.0, 30.0, point=0.3, count=200)
    rng = np.random.default_rng(7)
    found = [integrate_silhouette(replace(outline, points=noisy(outline, rng)), AXIS, ACROSS, 0.0) for _ in range(20)]
    assert np.mean([one.perimeter.value for one in found]) == pytest.approx(2.0 * np.pi * 30.0, rel=0.003)


def test_the_centroid_of_a_triangle_is_the_mean_of_its_corners():
    corners = np.array([[1.0, 0.0], [7.0, 2.0], [3.0, 9.0]])
    for points in (corners, corners[::-1]):
        assert centroid(points) == pytest.approx(corners.mean(axis=0))


@pytest.mark.parametrize(("point", "shared"), [(0.3, 0.0), (0.0, 0.3)])
def test_the_centroid_of_noisy_ellipses_scatters_as_it_says(point, shared):
    outline, direction = ellipse(40.0, 25.0, point=point, shared=shared), np.array([0.6, 0.8])
    rng = np.random.default_rng(8)
    places = [centroid(noisy(outline, rng)) @ direction for _ in range(600)]
    assert np.mean(places) == pytest.approx(AXIS @ direction, abs=0.02)
    assert np.var(places) == pytest.approx(centroid_variance(outline, direction), rel=0.2)


END, LENGTH, HALF_HEIGHT = np.array([20.0, 40.0]), 100.0, 34.0


def picture(depth=24.0, curvature=-0.02, width=3.0, dark=0.3, noise=0.0, seed=1):
    """Light (rows, columns) of a capsule that moves to the right."""
    y, x = np.mgrid[0:80, 0:140].astype(float)
    from_end = x - END[0]
    light = 1.0 - 0.3 * np.exp(-0.5 * (from_end / 2.0) ** 2) - 0.1 * (from_end > 0.0)
    band = from_end - depth - 0.5 * curvature * (y - END[1]) ** 2
    light -= dark * np.exp(-0.5 * (band / width) ** 2)
    return light + noise * np.random.default_rng(seed).standard_normal(light.shape)


def found(light, end=END, inwards=(1.0, 0.0), blur=0.0, noise=1e-3):
    return find_rear(light, np.asarray(end, float), np.array(inwards), LENGTH, HALF_HEIGHT, blur, noise)


@pytest.mark.parametrize(("depth", "curvature"), [(24.0, -0.02), (15.0, 0.0), (35.3, -0.035)])
@pytest.mark.parametrize("width", [2.0, 3.5])
def test_the_band_is_found_where_it_crosses_the_axis(depth, curvature, width):
    rear = found(picture(depth, curvature, width))
    assert rear.depth == pytest.approx(depth, abs=0.06)
    assert rear.curvature == pytest.approx(curvature, abs=0.002)
    assert rear.width == pytest.approx(width, rel=0.35)
    assert 0.6 * 0.3 * HALF_HEIGHT < rear.breadth <= 0.3 * HALF_HEIGHT
    assert rear.systematic < rear.depth_error**2 <= rear.systematic + 0.05**2


def test_it_is_the_same_from_either_side():
    mirrored = picture()[:, ::-1]
    left, right = found(mirrored, (139.0 - END[0], END[1]), (-1.0, 0.0)), found(picture())
    assert left.depth == pytest.approx(right.depth, abs=0.01)
    assert left.curvature == pytest.approx(right.curvature, abs=1e-3)
    downwards = found(picture().T, END[::-1], (0.0, 1.0))
    assert downwards.depth == pytest.approx(right.depth, abs=0.01)


def test_a_blur_across_the_axis_of_a_curved_band_is_taken_off():
    """The mean over a blur of standard deviation b shifts a parabola of curvature c by c b^2 / 2."""
    plain, blurred = found(picture()), found(picture(), blur=3.0)
    assert blurred.depth - plain.depth == pytest.approx(0.5 * 0.02 * 9.0, abs=0.005)


def test_the_place_of_the_membrane_within_a_wide_band_is_in_the_error():
    """Of this standard deviation; nothing is added in a band as narrow as those drawn elsewhere."""
    wide, narrow = found(picture(30.0, -0.01, 5.0)), found(picture(30.0, -0.01, 2.5))
    assert wide.within == pytest.approx(5.0, rel=0.15)
    assert wide.systematic > wide.within**2
    assert wide.depth_error > wide.within
    assert narrow.within == 0.0
    assert narrow.depth_error < 0.5


def test_its_error_holds_the_scatter_of_noisy_pictures():
    seen = [found(picture(noise=0.02, seed=seed), noise=0.02) for seed in range(40)]
    own = np.mean([rear.depth_error**2 - rear.systematic for rear in seen])
    assert np.var([rear.depth for rear in seen]) == pytest.approx(own, rel=0.6)
    assert np.mean([rear.depth for rear in seen]) == pytest.approx(24.0, abs=0.08)


def test_the_misfit_of_the_model_is_larger_next_to_the_band_of_the_outer_edge():
    near, far = found(picture(11.0, 0.0, 2.5)), found(picture(35.0, 0.0, 2.5))
    assert near.systematic > 1.5 * far.systematic
    assert 0.015 < np.sqrt(far.systematic) / far.width < 0.025


@pytest.mark.parametrize(
    "light",
    [picture(dark=0.0), picture(dark=0.01), picture(depth=50.0, curvature=0.0), picture(depth=5.0, curvature=0.0)],
    ids=["none", "too faint", "too deep", "within that of the outer edge"],
)
def test_where_no_band_is_distinct_there_is_no_rear(light):
    assert found(light) is None


def test_a_band_within_the_noise_is_none():
    assert found(picture(dark=0.05), noise=0.001) is not None
    assert found(picture(dark=0.05), noise=0.1) is None


def coarse(profile):
    """What is found where all rays see the same light, so near to the axis that no curvature of the band matters."""
    y = np.arange(-2.0, 3.0)
    return _coarse(np.tile(profile, (len(y), 1)), y, _CURVATURES / HALF_HEIGHT, 1e-3)


def dip(depth, dark, width=2.0):
    return dark * np.exp(-0.5 * ((np.arange(45.0) - depth) / width) ** 2)


@pytest.mark.parametrize(("dark", "seen"), [(0.018, False), (0.028, True)])
def test_a_band_is_darker_than_its_surroundings_by_two_hundredths_of_the_light(dark, seen):
    """The smoothing makes a band 3 px wide fainter by a tenth."""
    assert (coarse(0.9 - dip(24, dark, 3.0)) is not None) == seen


def test_the_search_knows_the_curvature_of_a_band_to_a_step_of_its_grid():
    y, depth = np.arange(-10.0, 11.0)[:, None], np.arange(45.0)
    rays = 0.9 - 0.3 * np.exp(-0.5 * ((depth - 24.0 + 0.5 * 0.05 * y**2) / 2.0) ** 2)
    place, curvature, width = _coarse(rays, y[:, 0], _CURVATURES / HALF_HEIGHT, 1e-3)
    assert place == pytest.approx(24, abs=1)
    assert curvature == pytest.approx(-0.05, abs=0.2 / HALF_HEIGHT)
    assert width == pytest.approx(2.0, abs=1.0)


def test_a_broad_band_is_fitted_over_its_breadth():
    """In a few pixels around its middle, the noise would leave nothing of it."""
    assert found(picture(30.0, 0.0, 6.0)).depth == pytest.approx(30.0, abs=0.1)
    for seed in range(8):
        noisy = found(picture(30.0, 0.0, 6.0, noise=0.02, seed=seed), noise=0.02)
        assert noisy.depth == pytest.approx(30.0, abs=1.5)


@pytest.mark.parametrize(("behind", "seen"), [(9.5, True), (13.5, False)])
def test_behind_the_band_it_brightens_again_within_ten_pixels(behind, seen):
    """A shallow band in the dark, behind which the light comes back at once."""
    depth = np.arange(45)
    profile = np.where((depth > 12) & (depth < 24 + behind), 0.50, 0.55) - dip(24, 0.01)
    assert (coarse(profile) is not None) == seen


@pytest.mark.parametrize(("between", "seen"), [(0.005, False), (0.1, True)])
def test_only_light_between_the_band_and_that_of_the_outer_edge_makes_them_two(between, seen):
    """The outer edge is darkest at 8 px; outside of it there is light in any case."""
    profile, depth = 0.9 - dip(24, 0.4) - dip(8, 0.4), np.arange(45)
    middle = (depth >= 8) & (depth <= 24)
    profile[middle] = 0.5 + between * np.sin(np.pi * (depth[middle] - 8) / 16.0)
    assert (coarse(profile) is not None) == seen


def test_intervals_of_a_rear_seen_in_few_strips_hold_it_as_often_as_they_say():
    """The noise is alike along the channel, and larger than the one stated."""
    half_height, depths, errors = 24.0, [], []
    for seed in range(300):
        light = picture() + 0.02 * gaussian_filter1d(
            np.random.default_rng(seed).standard_normal((80, 140)), 1.0, axis=1
        )
        found = find_rear(light, END, np.array([1.0, 0.0]), LENGTH, half_height, 1.0, 1e-6)
        depths.append(found.depth)
        errors.append(np.sqrt(found.depth_error**2 - found.systematic))
    off = np.abs(np.array(depths) - np.mean(depths)) / errors
    assert np.mean(off < 1.96) > 0.93
    assert np.mean(off < 1.0) > 0.66
