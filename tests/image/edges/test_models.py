"""Profiles drawn from each model, whose place and width are known."""

import numpy as np
import pytest
from scipy.special import erfc

from capsbayes.image.edge_models import Model, _evaluated, locate

SAMPLES = np.arange(-9.0, 10.0)
COEFFICIENTS = {
    Model.EDGE: [1.0, 0.01, -0.5, -0.02],
    Model.LINE: [-0.4, 0.9, 0.1],
    Model.BAND: [-0.3, 0.8, 0.01, 0.002],
}
every_model = pytest.mark.parametrize("model", Model)


def functions(model, place, width):
    """Functions of a model at the samples, the blurred ramp by an integral of the blurred step."""
    t = SAMPLES - place
    step, one = 0.5 * erfc(-t / (width * np.sqrt(2.0))), np.ones_like(t)
    bell = np.exp(-0.5 * (t / width) ** 2)
    if model is Model.LINE:
        return np.stack([bell, one, step], axis=1)
    if model is Model.BAND:
        return np.stack([bell, one, t, t**2], axis=1)
    fine = np.linspace(-30.0, 20.0, 100_001)
    steps = np.cumsum(0.5 * erfc(-fine / (width * np.sqrt(2.0)))) * (fine[1] - fine[0])
    ramp = np.interp(t, fine, steps)
    return np.stack([one, t - ramp, step, ramp], axis=1)


def drawn(model, place, width):
    return functions(model, place, width) @ COEFFICIENTS[model]


def located(model, profiles, *, place=0.0, width=1.5, used=None):
    profiles = np.atleast_2d(profiles)
    count = len(profiles)
    used = np.ones(profiles.shape) if used is None else used
    return locate(profiles, SAMPLES, model, np.full(count, place), np.full(count, width), used)


@every_model
@pytest.mark.parametrize(("place", "width"), [(0.6, 1.2), (-1.3, 2.0), (0.0, 1.5)])
def test_a_drawn_profile_is_found_again(model, place, width):
    fit = located(model, drawn(model, place, width))
    assert fit.converged[0]
    assert fit.place[0] == pytest.approx(place, abs=1e-3)
    assert fit.width[0] == pytest.approx(width, rel=2e-3)
    assert fit.coefficients[0] == pytest.approx(COEFFICIENTS[model], abs=2e-3)
    np.testing.assert_allclose(fit.fitted[0], drawn(model, place, width), atol=1e-4)


@every_model
def test_the_slope_is_the_change_by_a_shift_of_the_place(model):
    fit = located(model, drawn(model, 0.4, 1.8))
    change = (drawn(model, 0.41, 1.8) - drawn(model, 0.39, 1.8)) / 0.02
    np.testing.assert_allclose(fit.slope[0], change, atol=2e-3)


@every_model
def test_all_functions_and_derivatives_are_filled_in(model):
    """Compared with central differences of the functions."""
    place, width, step = 0.4, 1.8, 1e-3
    shape = len(SAMPLES), len(COEFFICIENTS[model])
    values, by_place, by_width = (np.full(shape, np.nan) for _ in range(3))
    _evaluated(int(model), 0.0, SAMPLES, np.ones(len(SAMPLES)), place, width, values, by_place, by_width)
    shifted = functions(model, place + step, width) - functions(model, place - step, width)
    wider = functions(model, place, width * np.exp(step)) - functions(model, place, width * np.exp(-step))
    np.testing.assert_allclose(values, functions(model, place, width), atol=2e-3)
    np.testing.assert_allclose(by_place, shifted / (2.0 * step), atol=2e-3)
    np.testing.assert_allclose(by_width, wider / (2.0 * step), atol=2e-3)


@pytest.mark.parametrize("bend", [-0.15, 0.3])
def test_darkness_that_falls_exponentially_is_found_again_with_its_bend(bend):
    """The band is the sum of a jump and an exponential of the depth, each blurred by quadrature."""
    place, width = 0.3, 1.6
    depth = np.linspace(0.0, 40.0, 40_001)
    band = np.exp(-bend * depth) if bend > 0.0 else np.where(depth < 15.0, np.exp(-bend * depth), 0.0)
    spread = np.exp(-0.5 * ((SAMPLES[:, None] - place - depth) / width) ** 2) / (width * np.sqrt(2.0 * np.pi))
    darkness = 0.2 * 0.5 * erfc((place - SAMPLES) / (width * np.sqrt(2.0)))
    darkness += 0.2 * (spread * band).sum(axis=1) * (depth[1] - depth[0])
    used = (np.abs(SAMPLES) <= 6.0).astype(float)
    start = np.zeros(1), np.array([1.3])
    fit, straight = (
        locate(1.0 - darkness[None], SAMPLES, Model.EDGE, *start, used[None], each) for each in (bend, 0.0)
    )
    assert fit.place[0] == pytest.approx(place, abs=5e-3)
    assert fit.width[0] == pytest.approx(width, rel=5e-3)
    np.testing.assert_allclose(fit.fitted[0], used * (1.0 - darkness), atol=3e-4)
    assert abs(straight.place[0] - place) > 0.02


def test_a_small_bend_is_none():
    profile = drawn(Model.EDGE, 0.4, 1.5)[None]
    places = [
        locate(profile, SAMPLES, Model.EDGE, np.zeros(1), np.ones(1), np.ones_like(profile), bend).place[0]
        for bend in (0.0, 1e-17, 1e-3)
    ]
    assert places == pytest.approx([0.4] * 3, abs=5e-3)


def test_the_place_moves_by_twelve_steps_of_at_most_a_pixel():
    """A broad line is followed from afar; one that is further off than that is not reached."""
    samples, width = np.arange(-40.0, 41.0), np.array([9.0])
    for far, reached in ((9.5, True), (12.5, False)):
        line = 0.9 - 0.4 * np.exp(-0.5 * ((samples - far) / width) ** 2)
        fit = locate(line[None], samples, Model.LINE, np.zeros(1), width, np.ones((1, len(samples))))
        assert fit.converged[0] == reached
        assert fit.place[0] == pytest.approx(far if reached else 12.0, abs=1e-3)


@every_model
def test_it_comes_from_afar_in_few_steps(model):
    fit = located(model, drawn(model, 1.7, 1.6), place=-0.5, width=2.2)
    assert fit.converged[0]
    assert fit.place[0] == pytest.approx(1.7, abs=2e-3)


@every_model
def test_the_variance_of_the_place_is_that_of_noisy_profiles(model):
    noise, rng = 0.005, np.random.default_rng(5)
    fit = located(model, drawn(model, 0.2, 1.5) + noise * rng.standard_normal((400, len(SAMPLES))))
    assert fit.converged.mean() > 0.98
    assert np.var(fit.place[fit.converged]) == pytest.approx(noise**2 * np.median(fit.place_variance), rel=0.25)


@every_model
def test_samples_that_are_not_used_change_nothing(model):
    profile = drawn(model, 0.3, 1.4)
    used = np.ones_like(profile)
    used[[0, 1, 17, 18]] = 0.0
    spoilt = np.where(used == 0.0, 5.0, profile)
    fit, other = (located(model, one, used=used[None]) for one in (profile, spoilt))
    assert other.place[0] == fit.place[0] == pytest.approx(0.3, abs=2e-3)
    assert fit.place_variance[0] > located(model, profile).place_variance[0]


@every_model
def test_brightness_and_contrast_change_neither_place_nor_width(model):
    profile = drawn(model, 0.5, 1.3)
    fit, other = located(model, profile), located(model, 0.3 + 0.6 * profile)
    assert other.place[0] == pytest.approx(fit.place[0], abs=1e-4)
    assert other.place_variance[0] == pytest.approx(fit.place_variance[0] / 0.36, rel=1e-3)


def test_widths_stay_in_their_bounds_and_a_wild_profile_does_not_converge():
    wild = np.random.default_rng(1).standard_normal((50, len(SAMPLES)))
    fit = located(Model.EDGE, wild)
    assert fit.width.min() >= 0.3
    assert fit.width.max() <= 12.0
    assert not fit.converged.all()
    sharp = located(Model.EDGE, np.where(SAMPLES > 0.5, 0.5, 1.0))
    assert sharp.width[0] == pytest.approx(0.3)
    assert sharp.place[0] == pytest.approx(0.5, abs=0.5)
