"""Outlines with known lengths: circle, ellipse, and a parachute with a concave rear."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ellipe

from capsbayes.errors import InputError
from capsbayes.profile import Profile, with_extent

CIRCLE_ANGLES = np.linspace(0.0, 2 * np.pi, 2000, endpoint=False)


def ellipse(long, short, angle=CIRCLE_ANGLES):
    return Profile(np.stack([long * np.cos(angle), short * np.sin(angle)], axis=1))


def parachute(depth, angle=CIRCLE_ANGLES):
    """A unit circle whose rear is pushed forward on the axis, z = cos t + depth (1 - cos t)^2 / 4, y = sin t.

    With depth > 1 the rear is concave: L_z = 1/depth, L_a = 2 - depth, L_p = (depth - 1)^2 / depth.
    """
    cosine = np.cos(angle)
    return Profile(np.stack([cosine + depth * (1 - cosine) ** 2 / 4, np.sin(angle)], axis=1))


@st.composite
def outlines(draw):
    """Smooth closed outlines around the axis, without symmetry."""
    amplitude = draw(st.lists(st.floats(-0.12, 0.12), min_size=4, max_size=4))
    angle = np.linspace(0.0, 2 * np.pi, 120, endpoint=False)
    radius = 1 + sum(size * np.sin((order + 1) * angle + order) for order, size in enumerate(amplitude))
    return Profile.from_outline(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))


def test_circle_and_ellipse():
    circle = ellipse(2.0, 2.0)
    assert circle.axial_extent == pytest.approx(4.0, rel=1e-12)
    assert circle.axial_length == pytest.approx(4.0, rel=1e-12)
    assert circle.parachute_depth == pytest.approx(0.0, abs=1e-12)
    assert circle.perimeter == pytest.approx(4 * np.pi, rel=1e-6)
    assert circle.area == pytest.approx(4 * np.pi, rel=1e-5)
    assert circle.stretch_ratio(2.0) == pytest.approx(1.0, rel=1e-6)
    long, short = 1.3, 0.7
    assert ellipse(long, short).perimeter == pytest.approx(4 * long * ellipe(1 - (short / long) ** 2), rel=1e-5)


def test_parachute_with_a_concave_rear():
    for depth in (1.3, 1.6, 1.9):
        outline = parachute(depth)
        assert outline.axial_extent == pytest.approx(1 / depth, abs=1e-5)
        assert outline.axial_length == pytest.approx(2 - depth, abs=1e-12)
        assert outline.parachute_depth == pytest.approx((depth - 1) ** 2 / depth, abs=1e-5)
        length, _ = quad(lambda t: np.hypot(np.sin(t) * (depth * (1 - np.cos(t)) / 2 - 1), np.cos(t)), 0, 2 * np.pi)  # noqa: B023
        assert outline.perimeter == pytest.approx(length, rel=1e-5)
    assert parachute(0.8).parachute_depth == pytest.approx(0.0, abs=1e-12)  # a convex rear


def test_half_outline_is_mirrored():
    angle = np.linspace(0.0, np.pi, 101)
    half = np.stack([np.cos(angle), 0.5 * np.sin(angle)], axis=1)
    whole = Profile.from_half(half)
    assert whole.points.shape == (200, 2)
    np.testing.assert_allclose(
        whole.points, ellipse(1.0, 0.5, np.linspace(0, 2 * np.pi, 200, endpoint=False)).points, atol=1e-12
    )


def test_any_start_and_sense_give_one_outline():
    known = parachute(1.5, np.linspace(0.0, 2 * np.pi, 300, endpoint=False))
    for start, sense, closed in itertools.product((0, 37, 150), (1, -1), (False, True)):
        contour = np.roll(known.points, start, axis=0)[::sense]
        contour = np.concatenate([contour, contour[: int(closed)]])
        np.testing.assert_allclose(Profile.from_outline(contour).points, known.points, atol=1e-14)


def test_the_nose_is_inserted_between_two_vertices():
    square = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
    outline = Profile.from_outline(square)
    np.testing.assert_allclose(outline.points, [[1, 0], [1, 1], [-1, 1], [-1, -1], [1, -1]])
    assert outline.axial_length == 2.0


def test_resampling_is_at_equal_arc_length_from_the_nose():
    outline = parachute(1.5).resampled(256)
    steps = np.linalg.norm(np.diff(outline.points, axis=0, append=outline.points[:1]), axis=1)
    assert outline.points.shape == (256, 2)
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.02)  # chords, shorter at the rim
    np.testing.assert_array_equal(outline.points[0], [1.0, 0.0])
    np.testing.assert_allclose(outline.points[128], [0.5, 0.0], atol=1e-9)
    assert outline.perimeter == pytest.approx(parachute(1.5).perimeter, rel=1e-3)


@given(outlines(), st.floats(1e-6, 1e3), st.floats(-5, 5))
def test_lengths_scale_and_know_neither_place_nor_side(outline, factor, dz):
    changed = outline.translated(dz).scaled(factor)
    for name in ("axial_extent", "axial_length", "perimeter"):
        assert getattr(changed, name) == pytest.approx(factor * getattr(outline, name), rel=1e-9)
    assert changed.area == pytest.approx(factor**2 * outline.area, rel=1e-8)
    assert changed.stretch_ratio(factor * 0.9) == pytest.approx(outline.stretch_ratio(0.9), rel=1e-9)
    mirror = outline.mirrored()
    for name in ("axial_extent", "axial_length", "perimeter", "area"):
        assert getattr(mirror, name) == pytest.approx(getattr(outline, name), rel=1e-9)
    np.testing.assert_array_equal(mirror.mirrored().points, outline.points)


@settings(deadline=None)  # the first distance imports shapely
@given(outlines(), outlines(), st.floats(0.1, 10))
def test_hausdorff_is_a_distance(one, other, factor):
    distance = one.hausdorff(other)
    assert one.hausdorff(one) == 0.0
    assert distance == other.hausdorff(one)
    assert one.mirrored().hausdorff(other.mirrored()) == pytest.approx(distance, abs=1e-9)
    assert one.scaled(factor).hausdorff(other.scaled(factor)) == pytest.approx(factor * distance, rel=1e-9, abs=1e-12)


def test_hausdorff_of_concentric_circles_is_the_gap_whatever_the_vertices():
    coarse = ellipse(1.2, 1.2, np.linspace(0, 2 * np.pi, 301, endpoint=False))
    assert coarse.hausdorff(ellipse(1.0, 1.0)) == pytest.approx(0.2, abs=1e-4)
    assert coarse.hausdorff(coarse.translated(0.03)) == pytest.approx(0.03, abs=1e-4)


def test_points_out_of_order_are_refused_with_one_line():
    for points, message in (
        (np.zeros((3, 2)), "expected an array (p, 2) with p >= 4, got shape (3, 2)"),
        (np.zeros((5, 3)), "got shape (5, 3)"),
        ([[1, 0], [0, 1], [-1, np.nan], [0, -1]], "expected finite coordinates, got 1 NaN"),
        ([[0, 1], [-1, 0], [0, -1], [1, 0]], "expected a first point on the axis y = 0, got y = 1"),
        ([[-1, 0], [0, -1], [1, 0], [0, 1]], "expected the nose as first point"),
        ([[1, 0], [0, -1], [-1, 0], [0, 1]], "expected the side y > 0 first"),
    ):
        with pytest.raises(InputError) as caught:
            Profile(np.asarray(points, dtype=float))
        assert message in str(caught.value)
        assert str(caught.value).startswith("profile: points: ")
    with pytest.raises(InputError, match="expected an outline around the axis y = 0, got 0 crossings"):
        Profile.from_outline([[0, 1], [1, 1], [1, 2], [0, 2]])
    with pytest.raises(ValueError, match="read-only"):
        ellipse(1.0, 1.0).points[0, 0] = 3.0


def test_points_at_equal_distances_cut_a_sharp_rim_until_it_is_given_its_extent():
    """A parachute whose rim has a radius of a fiftieth: half circle, rim, shallow rear."""
    outer = np.linspace(0.0, 0.5 * np.pi, 500)
    rim = np.linspace(0.5 * np.pi, 1.5 * np.pi, 200)[1:]
    y = np.linspace(0.96, 0.0, 500)[1:]
    half = np.concatenate(
        [
            np.stack([np.cos(outer), np.sin(outer)], axis=1),
            [0.0, 0.98] + 0.02 * np.stack([np.cos(rim), np.sin(rim)], axis=1),
            np.stack([0.3 * (1.0 - (y / 0.96) ** 2), y], axis=1),
        ]
    )
    fine = Profile.from_half(half)
    for count in (64, 90, 128, 256):
        coarse = fine.resampled(count)
        mended = Profile(with_extent(coarse.points, fine.axial_extent))
        assert mended.axial_extent == pytest.approx(fine.axial_extent, rel=1e-9)
        assert mended.axial_length == pytest.approx(coarse.axial_length, rel=1e-9)
        assert mended.hausdorff(fine) <= coarse.hausdorff(fine)
        np.testing.assert_allclose(mended.mirrored().points, mended.points, atol=1e-9)
