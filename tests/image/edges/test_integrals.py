from dataclasses import replace

import numpy as np
import pytest
from drawn import HALF_WIDTH, circle, drawn
from known_outlines import ellipse, noisy
from scipy.special import ellipe

from capsbayes.image.edges import EDGE_FLOOR, centroid, centroid_variance, integrate_silhouette
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.image.synthetic import Optics, Scene, draw
from capsbayes.profile import Profile


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
