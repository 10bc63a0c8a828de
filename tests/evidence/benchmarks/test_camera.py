"""The renderer of the benchmarks, against areas, moments and lengths that are known."""

import numpy as np
import pytest

from capsbayes.database import Database
from evidence.benchmarks import camera
from evidence.benchmarks.camera import Camera, Capsule, View, covered, photograph, seen_through

CASES = Database.open("square-neo-hookean").converged


def view_of(case, **changes):
    capsule = Capsule(CASES["profile"][case], CASES["silhouette"][case], (109.0, 98.7))
    return View((capsule,), 60.0, (200, 220), **changes)


def positions(shape):
    """Return the places (x, y) of the fine pixels of a picture."""
    y, x = ((np.arange(camera.FINE * count) + 0.5) / camera.FINE - 0.5 for count in shape)
    return x, y[:, None]


def moments(light):
    """Return mean and variance of the places x and y, weighted by light."""
    total = light.sum()
    means, variances = [], []
    for place in positions(np.array(light.shape) // camera.FINE):
        means.append((light * place).sum() / total)
        variances.append((light * place**2).sum() / total - means[-1] ** 2)
    return means, variances


@pytest.mark.parametrize("sense", [1, -1])
def test_a_disc_covers_its_area_about_its_centre(sense):
    angle = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    disc = np.stack([41.3 + 20.0 * np.cos(angle), 30.2 + 20.0 * np.sin(angle)], axis=1)[::sense]
    share = covered(disc, (60, 80))
    assert share.min() == 0.0
    assert share.max() == 1.0
    assert share.sum() / camera.FINE**2 == pytest.approx(400.0 * np.pi, rel=1e-3)
    np.testing.assert_allclose(moments(share)[0], [41.3, 30.2], atol=5e-3)


def test_a_loop_that_turns_the_other_way_covers_nothing():
    square, loop = [[10, 10], [30, 10], [30, 30], [10, 30]], [[10, 10], [12, 5], [8, 5]]
    alone, both = (covered(np.array(points, dtype=float), (40, 40)).sum() for points in (square, square + loop))
    assert alone == both == 400 * camera.FINE**2


@pytest.mark.parametrize(
    ("transfer", "spread"),
    [
        (camera._lens(Camera(blur=1.5)), (2.25, 2.25)),
        (camera._lens(Camera(blur=0.0, defocus=4.0)), (4.0, 4.0)),  # of a disc a quarter of the radius squared
        (camera._motion(6.0, np.array([1.0, 0.0])), (3.0, 0.0)),  # of a line a twelfth of its length squared
    ],
)
def test_lens_and_motion_spread_light_as_they_should(transfer, spread):
    x, y = positions((50, 60))
    spot = np.exp(-0.5 * ((x - 29.4) ** 2 + (y - 25.3) ** 2) / 2.0**2)
    (before, narrow), (after, wide) = moments(spot), moments(seen_through(spot, transfer))
    np.testing.assert_allclose(after, before, atol=1e-6)
    np.testing.assert_allclose(np.subtract(wide, narrow), spread, rtol=1e-3, atol=1e-3)


def test_a_film_moves_the_capsule_by_its_steps():
    frames, empty = camera.film(
        view_of(40, tilt=0.02), Camera(photons=1e7, constant_noise=0.0), np.array([0.0, 7.3]), seed=3
    )
    dark = [np.maximum(empty.astype(float) - frame, 0.0)[40:160] for frame in frames]
    x = [(one * np.arange(220)).sum() / one.sum() for one in dark]
    assert x[1] - x[0] == pytest.approx(7.3 * np.cos(0.02), abs=0.05)


def test_the_truth_is_that_of_the_simulation():
    for case in (0, 40, 200):
        view = view_of(case)
        assert view.axial_extent == pytest.approx(60.0 * CASES["axial_extent"][case], abs=0.05)
        assert view.axial_length == pytest.approx(60.0 * CASES["axial_length"][case], abs=0.05)


def test_exposures_differ_by_their_seed_alone_and_inversion_exchanges_dark_and_bright():
    view = view_of(40)
    first, again, other = (photograph(view, Camera(), seed=seed)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert 0.5 < np.std(first.astype(float) - other) < 5.0
    np.testing.assert_array_equal(photograph(view, Camera(inverted=True), seed=1)[0], 255 - first)
