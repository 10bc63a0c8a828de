"""The located outline, its ends, its rear and its integrals."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from drawn import HALF_WIDTH, circle, drawn
from known_outlines import ellipse, noisy
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.signal import savgol_coeffs
from scipy.special import ellipe

from capsbayes.image.edges import (
    _CURVATURES,
    EDGE_FLOOR,
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
from capsbayes.profile import Profile
from evidence.synthetic import Optics, Scene, draw

RADIUS, CENTRE, FINE = 20.0, np.array([34.3, 31.8]), 5
ALONG, ACROSS = np.array([1.0, 0.0]), np.array([0.0, 1.0])


def disc(blur=1.2, noise=0.0, seed=1, dark=0.4):
    """Light of a disc (rows, columns), drawn on pixels five times finer and blurred there; a blur may be (x, y)."""
    fine = (np.arange(68 * FINE) + 0.5) / FINE - 0.5
    inside = np.hypot(fine - CENTRE[0], fine[: 64 * FINE, None] - CENTRE[1]) < RADIUS
    light = gaussian_filter(1.0 - dark * inside, FINE * np.broadcast_to(blur, 2)[::-1], mode="nearest")
    light = light.reshape(64, FINE, 68, FINE).mean(axis=(1, 3))
    return light + noise * np.random.default_rng(seed).standard_normal(light.shape)


ANGLE = 2.0 * np.pi * np.arange(60) / 60
POLYGON = CENTRE + (RADIUS + 0.7) * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)


def off(outline):
    return np.hypot(*(outline.points - CENTRE).T) - RADIUS


@pytest.mark.parametrize("blur", [0.8, 1.2, 2.5])
def test_the_edge_of_a_disc_is_its_circle_with_the_width_of_the_blur(blur):
    outline = locate_edge(disc(blur), POLYGON, 1e-3)
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
    outline = locate_edge(disc(blur), POLYGON, 1e-3)
    assert np.sqrt(np.mean(off(outline) ** 2)) < 0.13
    assert np.abs(off(outline)).max() < 0.25
    for axis in (0, 1):
        facing = np.abs(outline.normals[:, axis]) > 0.95
        assert np.median(outline.edge_width[facing]) == pytest.approx(blur[axis], rel=0.3)
        assert abs(off(outline)[facing].mean()) < 0.1


def test_the_outline_moves_with_the_capsule_through_the_picture():
    here, shift = locate_edge(disc(), POLYGON, 1e-3), np.array([40.0, 50.0])
    there = locate_edge(np.pad(disc(), ((50, 10), (40, 20)), mode="edge"), POLYGON + shift, 1e-3)
    np.testing.assert_allclose(there.points, here.points + shift, atol=1e-3)


def test_errors_of_the_points_are_the_scatter_of_noisy_pictures():
    noise = 0.01
    places, stated, shared = [], [], []
    for seed in range(20):
        outline = locate_edge(disc(noise=noise, seed=seed), POLYGON, noise)
        at = off(outline)
        means = np.bincount(outline.arc, at) / np.bincount(outline.arc)
        places.append(np.var(at - means[outline.arc]))
        shared.append((np.var(means), np.mean(outline.arc_error**2)))
        stated.append(np.mean(outline.point_error**2))
    assert np.mean(places) == pytest.approx(np.mean(stated), rel=0.35)
    scatter, expected = np.mean(shared, axis=0)
    assert scatter == pytest.approx(expected, rel=0.6)
    one, two = (locate_edge(disc(), POLYGON, noise) for noise in (0.01, 0.02))
    np.testing.assert_allclose(two.point_error, 2.0 * one.point_error)
    np.testing.assert_allclose(two.arc_error, 2.0 * one.arc_error)


@pytest.mark.parametrize(
    ("light", "noise", "seen"),
    [
        (1.0 + 0.01 * np.random.default_rng(1).standard_normal((64, 68)), 0.01, False),
        (2.0 - disc(), 0.01, False),  # brighter inside
        (disc(dark=0.036), 1e-4, True),
        (disc(dark=0.024), 1e-4, False),
    ],
)
def test_without_a_jump_by_three_hundredths_of_the_light_there_is_no_edge(light, noise, seen):
    assert (locate_edge(light, POLYGON, noise) is not None) == seen


def test_where_there_is_no_edge_the_outline_follows_its_neighbours_with_an_error_of_a_third_of_a_pixel():
    """The disc fades to the right; the curve given there is 0.7 px outside of it."""
    y, x = np.mgrid[:64, :68]
    away = np.abs(np.arctan2(y - CENTRE[1], x - CENTRE[0]))
    outline = locate_edge(1.0 - (1.0 - disc()) * np.clip((away - 0.8) / 0.3, 0.0, 1.0), POLYGON, 1e-3)
    angle = np.abs(np.arctan2(*(outline.points - CENTRE).T[::-1]))
    right, left = angle < 0.3, angle > 1.6
    assert np.abs(off(outline)[right]).max() < 0.3
    np.testing.assert_allclose(outline.arc_error[right], 0.3)
    assert not outline.located[right].any()
    assert outline.located[left].all()
    assert np.abs(off(outline)[left]).max() < 0.1
    assert outline.arc_error[left].max() < 0.05


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
    off_means, off = (np.hypot(*(means / [60.0, 20.0]).T) - 1.0 for means in (averaged(points), thinned(points)))
    assert np.abs(off_means).max() * 60.0 > 0.05
    assert np.abs(off).max() < 0.2 * np.abs(off_means).max()
    assert len(thinned(points[:-1])) == len(points) // 3 - 1


@pytest.mark.parametrize(("a", "b"), [(30.0, 30.0), (40.0, 20.0), (20.0, 40.0)])
@pytest.mark.parametrize("tilt", [0.0, 0.7, 3.0])
def test_the_furthest_point_is_the_end_of_an_axis_however_the_ellipse_lies(a, b, tilt):
    direction = np.array([np.cos(tilt), np.sin(tilt)])
    here, there = (furthest_point(ellipse(a, b, tilt=tilt), side * direction, 0.0) for side in (1.0, -1.0))
    assert here.distance == pytest.approx(direction @ [40.0, 30.0] + a, abs=0.01)
    assert here.distance + there.distance == pytest.approx(2.0 * a, abs=0.02)


@pytest.mark.parametrize(
    ("point", "shared", "real", "count", "tolerance"),
    [(0.2, 0.0, 0.2, 400, 0.3), (0.0, 0.15, 0.0, 400, 0.3), (0.05, 0.0, 0.4, 200, 0.4)],
    ids=["of points", "of arcs", "larger than stated"],
)
def test_its_error_is_the_scatter_of_outlines(point, shared, real, count, tolerance):
    outline = ellipse(30.0, 28.0, point=point, shared=shared, arcs=20)
    drawn_from, rng = replace(outline, point_error=np.full(240, real)), np.random.default_rng(3)
    drawings = (replace(outline, points=noisy(drawn_from, rng, within_arcs=False)) for _ in range(count))
    ends = [furthest_point(drawing, ALONG, 0.0) for drawing in drawings]
    assert np.mean([end.distance for end in ends]) == pytest.approx(70.0, abs=0.1)
    stated = np.mean([end.variance - end.systematic for end in ends])
    assert np.var([end.distance for end in ends]) == pytest.approx(stated, rel=tolerance)


def test_what_all_pictures_share_is_the_floor_and_the_misfit_of_the_model():
    """The first term that the model lacks grows with the square of the edge's width."""
    sharp, blurred = (furthest_point(ellipse(30.0, 30.0, width=width), ALONG, 0.02) for width in (1.0, 3.0))
    assert sharp.systematic == pytest.approx(0.02**2 + 0.03**2)
    assert blurred.systematic == pytest.approx(0.18**2 + 0.03**2)
    assert sharp.variance >= sharp.systematic
    wide, wider = (furthest_point(ellipse(30.0, 30.0, width=width), ALONG, 0.5) for width in (2.0, 4.0))
    assert wider.variance - wider.systematic == pytest.approx(16.0 * (wide.variance - wide.systematic), rel=0.01)


def test_next_to_a_sharp_tip_few_points_count():
    """An ellipse twelve times as long as it is broad is no quartic over many points."""
    end = furthest_point(ellipse(60.0, 5.0, point=0.02), ALONG, 0.0)
    assert end.distance == pytest.approx(100.0, abs=0.06)


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
    end = furthest_point(replace(outline, points=outline.points + turn[:, None] * ALONG), ALONG, 0.0)
    student = scipy.stats.t.ppf(0.975, 26) / scipy.stats.norm.ppf(0.975)
    own = error**2 * np.sum(savgol_coeffs(2 * kept + 1, 4) ** 2) * (misfit * student**2 if kept == 15 else 1.0)
    assert end.variance - end.systematic == pytest.approx(own, rel=0.05)


@pytest.mark.parametrize("top", [-0.3, 0.3])
def test_the_width_of_the_edge_is_that_at_the_furthest_point(top):
    outline = replace(parabola(top=top), edge_width=1.0 + 0.05 * np.abs(np.arange(240) - 120))
    assert furthest_point(outline, ALONG, 0.1).systematic == pytest.approx(0.1**2 + 0.03**2)


def seen(made):
    return detect(Picture.from_array(made.picture), background=Picture.from_array(made.background))


AXIS = np.array([40.0, 30.0])
NAMES = ("area", "perimeter", "volume", "stretch_ratio")


def of_ellipse(a, b):
    """Area and perimeter of an ellipse, and volume and stretch ratio of the spheroid about the axis along a."""
    perimeter, sphere = 4.0 * a * ellipe(1.0 - (b / a) ** 2), (a * b * b) ** (1.0 / 3.0)
    return np.pi * a * b, perimeter, 4.0 / 3.0 * np.pi * a * b * b, perimeter / (2.0 * np.pi * sphere)


def test_integrals_and_centroids_of_drawn_pictures_are_the_truth_within_their_errors():
    """Of a disc those of a sphere, of a capsule those of its silhouette."""
    sphere = seen(draw(Scene(circle(0.8), circle(0.8), half_width=HALF_WIDTH), Optics(), seed=2)).integrals
    for name, value in zip(NAMES, of_ellipse(0.8 * HALF_WIDTH, 0.8 * HALF_WIDTH), strict=True):
        integral = getattr(sphere, name)
        assert abs(integral.value - value) < 2.5 * integral.error, name
        assert integral.error < 0.006 * value, name
    made = drawn(0.05, 0.8)
    capsule, outline = seen(made).integrals, Profile.from_outline(HALF_WIDTH * np.asarray(made.scene.silhouette))
    assert capsule.area.value == pytest.approx(outline.area, abs=2.5 * capsule.area.error)
    assert capsule.perimeter.value == pytest.approx(outline.perimeter, abs=2.5 * capsule.perimeter.error)
    scenes = [draw(Scene(circle(0.8), circle(0.8), 30.0, (90, 90)), Optics(electrons=2000), seed=s) for s in range(20)]
    outlines = [seen(made).outline for made in scenes]
    places = [centroid(outline.points)[0] for outline in outlines]
    expected = np.sqrt(np.mean([centroid_variance(outline, ALONG) for outline in outlines]))
    assert np.mean(places) == pytest.approx(44.5, abs=0.02)
    assert 0.4 * expected < np.std(places) < 1.4 * expected


@pytest.mark.parametrize(("a", "b"), [(30.0, 30.0), (40.0, 25.0), (25.0, 35.0)])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_of_a_spheroid_they_are_the_closed_forms(a, b, tilt):
    across = np.array([-np.sin(tilt), np.cos(tilt)])
    made = integrate_silhouette(ellipse(a, b, tilt=tilt, count=400), AXIS + 5.0 * across[::-1] * [1, -1], across, 0.0)
    for name, value in zip(NAMES, of_ellipse(a, b), strict=True):
        assert getattr(made, name).value == pytest.approx(value, rel=3e-4), name


def test_of_two_unlike_halves_the_volume_is_the_mean():
    """An axis off the middle cuts a circle into two unlike caps."""
    radius, aside = 30.0, 6.0
    made = integrate_silhouette(ellipse(radius, radius, count=4000), AXIS + aside * ACROSS, ACROSS, 0.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 200_001)
    step = np.diff(radius * np.cos(angle))
    bodies = []
    for sign in (1.0, -1.0):
        square = np.maximum(sign * (radius * np.sin(angle) - aside), 0.0) ** 2
        bodies.append(abs(np.sum(0.5 * np.pi * (square[1:] + square[:-1]) * step)))
    assert made.volume.value == pytest.approx(np.mean(bodies), rel=2e-3)


@pytest.mark.parametrize(("point", "shared"), [(0.05, 0.0), (0.0, 0.3)])
def test_their_errors_are_the_scatter_of_outlines_with_such_errors(point, shared):
    outline = ellipse(40.0, 25.0, point=point, shared=shared, count=200, arcs=10)
    rng = np.random.default_rng(6)
    made = [integrate_silhouette(replace(outline, points=noisy(outline, rng)), AXIS, ACROSS, 0.0) for _ in range(200)]
    stated = integrate_silhouette(outline, AXIS, ACROSS, 0.0)
    least = integrate_silhouette(ellipse(40.0, 25.0, count=200, arcs=10), AXIS, ACROSS, 0.0)
    for name in NAMES:
        scatter = np.std([getattr(each, name).value for each in made])
        own = np.sqrt(getattr(stated, name).error ** 2 - getattr(least, name).error ** 2)
        assert 0.85 * scatter < own < 1.15 * scatter + 1e-4 * getattr(stated, name).value, name


def test_an_edge_that_is_everywhere_too_far_out_changes_them_by_their_errors():
    """By the misfit times the square of the width of the edge, or by the floor if that is more."""
    radius, width, misfit = 30.0, 3.0, 0.05
    made = integrate_silhouette(ellipse(radius, radius, width=width, count=400), AXIS, ACROSS, misfit)
    out = np.hypot(misfit * width**2, EDGE_FLOOR)
    assert made.area.error == pytest.approx(2.0 * np.pi * radius * out, rel=0.01)
    assert made.perimeter.error == pytest.approx(2.0 * np.pi * out, rel=0.01)
    assert made.volume.error == pytest.approx(4.0 * np.pi * radius**2 * out, rel=0.01)
    assert made.stretch_ratio.error < 0.02 * out / radius


def test_noise_of_the_points_does_not_lengthen_the_perimeter():
    outline, rng = ellipse(30.0, 30.0, point=0.3, count=200), np.random.default_rng(7)
    drawings = (replace(outline, points=noisy(outline, rng)) for _ in range(20))
    lengths = [integrate_silhouette(drawing, AXIS, ACROSS, 0.0).perimeter.value for drawing in drawings]
    assert np.mean(lengths) == pytest.approx(2.0 * np.pi * 30.0, rel=0.003)


def test_the_centroid_of_a_triangle_is_the_mean_of_its_corners_and_of_noisy_ellipses_scatters_as_it_says():
    corners = np.array([[1.0, 0.0], [7.0, 2.0], [3.0, 9.0]])
    for points in (corners, corners[::-1]):
        assert centroid(points) == pytest.approx(corners.mean(axis=0))
    direction, rng = np.array([0.6, 0.8]), np.random.default_rng(8)
    for point, shared in ((0.3, 0.0), (0.0, 0.3)):
        outline = ellipse(40.0, 25.0, point=point, shared=shared)
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


def rear_of(light, end=END, inwards=ALONG, blur=0.0, noise=1e-3, half_height=HALF_HEIGHT):
    return find_rear(light, np.asarray(end, float), np.array(inwards), LENGTH, half_height, blur, noise)


@pytest.mark.parametrize(("depth", "curvature"), [(24.0, -0.02), (15.0, 0.0), (35.3, -0.035)])
@pytest.mark.parametrize("width", [2.0, 3.5])
def test_the_band_is_found_where_it_crosses_the_axis(depth, curvature, width):
    rear = rear_of(picture(depth, curvature, width))
    assert rear.depth == pytest.approx(depth, abs=0.06)
    assert rear.curvature == pytest.approx(curvature, abs=0.002)
    assert rear.width == pytest.approx(width, rel=0.35)
    assert 0.6 * 0.3 * HALF_HEIGHT < rear.breadth <= 0.3 * HALF_HEIGHT
    assert rear.systematic < rear.depth_error**2 <= rear.systematic + 0.05**2


def test_it_is_the_same_from_any_side_and_a_blur_across_a_curved_band_is_taken_off():
    """The mean over a blur of standard deviation b shifts a parabola of curvature c by c b^2 / 2."""
    right = rear_of(picture())
    left, down = rear_of(picture()[:, ::-1], (119.0, 40.0), -ALONG), rear_of(picture().T, END[::-1], ACROSS)
    assert left.depth == pytest.approx(right.depth, abs=0.01)
    assert left.curvature == pytest.approx(right.curvature, abs=1e-3)
    assert down.depth == pytest.approx(right.depth, abs=0.01)
    assert rear_of(picture(), blur=3.0).depth - right.depth == pytest.approx(0.5 * 0.02 * 9.0, abs=0.005)


def test_the_place_of_the_membrane_within_a_wide_band_and_the_band_of_the_outer_edge_are_in_the_error():
    """Of the band's standard deviation; nothing is added in a band as narrow as those drawn elsewhere."""
    wide, narrow = rear_of(picture(30.0, -0.01, 5.0)), rear_of(picture(30.0, -0.01, 2.5))
    assert wide.within == pytest.approx(5.0, rel=0.15)
    assert wide.systematic > wide.within**2
    assert wide.depth_error > wide.within
    assert narrow.within == 0.0
    assert narrow.depth_error < 0.5
    near, far = rear_of(picture(11.0, 0.0, 2.5)), rear_of(picture(35.0, 0.0, 2.5))
    assert near.systematic > 1.5 * far.systematic
    assert 0.015 < np.sqrt(far.systematic) / far.width < 0.025


def test_its_error_holds_the_scatter_of_noisy_pictures():
    rears = [rear_of(picture(noise=0.02, seed=seed), noise=0.02) for seed in range(40)]
    own = np.mean([rear.depth_error**2 - rear.systematic for rear in rears])
    assert np.var([rear.depth for rear in rears]) == pytest.approx(own, rel=0.6)
    assert np.mean([rear.depth for rear in rears]) == pytest.approx(24.0, abs=0.08)


@pytest.mark.parametrize(
    ("shape", "noise"),
    [
        ({"dark": 0.0}, 1e-3),
        ({"dark": 0.01}, 1e-3),
        ({"depth": 50.0, "curvature": 0.0}, 1e-3),
        ({"depth": 5.0, "curvature": 0.0}, 1e-3),
        ({"dark": 0.05}, 0.1),
    ],
    ids=["none", "too faint", "too deep", "within that of the outer edge", "within the noise"],
)
def test_where_no_band_is_distinct_there_is_no_rear(shape, noise):
    assert rear_of(picture(**shape), noise=noise) is None
    assert rear_of(picture(dark=0.05), noise=1e-3) is not None


DEPTH = np.arange(45.0)


def dip(depth, dark, width=2.0):
    return dark * np.exp(-0.5 * ((DEPTH - depth) / width) ** 2)


def shallow(behind):
    """A shallow band in the dark, behind which the light comes back at once."""
    return np.where((DEPTH > 12) & (behind > DEPTH - 24), 0.50, 0.55) - dip(24, 0.01)


def two(between):
    """A band, and that of the outer edge, which is darkest at 8 px; outside of it there is light in any case."""
    profile, middle = 0.9 - dip(24, 0.4) - dip(8, 0.4), (DEPTH >= 8) & (DEPTH <= 24)
    return np.where(middle, 0.5 + between * np.sin(np.pi * (DEPTH - 8) / 16.0), profile)


@pytest.mark.parametrize(
    ("profile", "distinct"),
    [
        (0.9 - dip(24, 0.018, 3.0), False),  # two hundredths of the light; the smoothing takes a tenth of it
        (0.9 - dip(24, 0.028, 3.0), True),
        (shallow(9.5), True),  # it brightens again within ten pixels
        (shallow(13.5), False),
        (two(0.005), False),  # only light between them makes them two
        (two(0.1), True),
    ],
)
def test_a_band_is_sought_that_is_darker_than_its_surroundings(profile, distinct):
    """All rays see the same light, so near to the axis that no curvature of the band matters."""
    y = np.arange(-2.0, 3.0)
    assert (_coarse(np.tile(profile, (len(y), 1)), y, _CURVATURES / HALF_HEIGHT, 1e-3) is not None) == distinct


def test_the_search_knows_the_curvature_of_a_band_to_a_step_of_its_grid():
    y = np.arange(-10.0, 11.0)[:, None]
    rays = 0.9 - 0.3 * np.exp(-0.5 * ((DEPTH - 24.0 + 0.5 * 0.05 * y**2) / 2.0) ** 2)
    place, curvature, width = _coarse(rays, y[:, 0], _CURVATURES / HALF_HEIGHT, 1e-3)
    assert place == pytest.approx(24, abs=1)
    assert curvature == pytest.approx(-0.05, abs=0.2 / HALF_HEIGHT)
    assert width == pytest.approx(2.0, abs=1.0)


def test_a_broad_band_is_fitted_over_its_breadth():
    """In a few pixels around its middle, the noise would leave nothing of it."""
    assert rear_of(picture(30.0, 0.0, 6.0)).depth == pytest.approx(30.0, abs=0.1)
    for seed in range(8):
        rear = rear_of(picture(30.0, 0.0, 6.0, noise=0.02, seed=seed), noise=0.02)
        assert rear.depth == pytest.approx(30.0, abs=1.5)


def test_intervals_of_a_rear_seen_in_few_strips_hold_it_as_often_as_they_say():
    """The noise is alike along the channel, and larger than the one stated."""
    noise = (np.random.default_rng(seed).standard_normal((80, 140)) for seed in range(300))
    lights = (picture() + 0.02 * gaussian_filter1d(each, 1.0, axis=1) for each in noise)
    rears = [rear_of(light, blur=1.0, noise=1e-6, half_height=24.0) for light in lights]
    depths = np.array([rear.depth for rear in rears])
    off = np.abs(depths - depths.mean()) / [np.sqrt(rear.depth_error**2 - rear.systematic) for rear in rears]
    assert np.mean(off < 1.96) > 0.93
    assert np.mean(off < 1.0) > 0.66
