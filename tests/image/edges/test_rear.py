"""A dark parabola behind a dark rear end, drawn in closed form."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from capsbayes.image.edges import _CURVATURES, _coarse, find_rear

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
