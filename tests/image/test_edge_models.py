"""Models of edges fitted to profiles, lines without outliers, and bridges, compared with numpy and scipy."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter
from scipy.special import erfc

from capsbayes.image.edge_models import (
    Model,
    _evaluated,
    bridge_errors,
    bridged,
    fit_without_outliers,
    locate,
    median,
    misfit_around,
    quantile,
    robust_spread,
    sampled,
    wider_by_few,
    within,
)

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
    step, ones = 0.5 * erfc(-t / (width * np.sqrt(2.0))), np.ones_like(t)
    bell = np.exp(-0.5 * (t / width) ** 2)
    fine = np.linspace(-30.0, 20.0, 100_001)
    steps = np.cumsum(0.5 * erfc(-fine / (width * np.sqrt(2.0)))) * (fine[1] - fine[0])
    ramp = np.interp(t, fine, steps)
    of_models = {
        Model.EDGE: [ones, t - ramp, step, ramp],
        Model.LINE: [bell, ones, step],
        Model.BAND: [bell, ones, t, t**2],
    }
    return np.stack(of_models[model], axis=1)


def drawn(model, place, width):
    return functions(model, place, width) @ COEFFICIENTS[model]


def located(model, profiles, *, place=0.0, width=1.5, used=None, bend=0.0):
    profiles = np.atleast_2d(profiles)
    count, used = len(profiles), np.ones(profiles.shape) if used is None else used
    return locate(profiles, SAMPLES, model, np.full(count, place), np.full(count, width), used, bend)


@every_model
@pytest.mark.parametrize(("place", "width"), [(0.6, 1.2), (-1.3, 2.0), (0.0, 1.5)])
def test_a_drawn_profile_is_found_again_with_its_slope(model, place, width):
    fit = located(model, drawn(model, place, width))
    assert fit.converged[0]
    assert fit.place[0] == pytest.approx(place, abs=1e-3)
    assert fit.width[0] == pytest.approx(width, rel=2e-3)
    assert fit.coefficients[0] == pytest.approx(COEFFICIENTS[model], abs=2e-3)
    np.testing.assert_allclose(fit.fitted[0], drawn(model, place, width), atol=1e-4)
    change = (drawn(model, place + 0.01, width) - drawn(model, place - 0.01, width)) / 0.02
    np.testing.assert_allclose(fit.slope[0], change, atol=2e-3)


@every_model
def test_all_functions_and_derivatives_are_filled_in(model):
    """Compared with central differences of the functions."""
    place, width, step = 0.4, 1.8, 1e-3
    filled = [np.full((len(SAMPLES), len(COEFFICIENTS[model])), np.nan) for _ in range(3)]
    _evaluated(int(model), 0.0, SAMPLES, np.ones(len(SAMPLES)), place, width, *filled)
    shifted = functions(model, place + step, width) - functions(model, place - step, width)
    wider = functions(model, place, width * np.exp(step)) - functions(model, place, width * np.exp(-step))
    expected = functions(model, place, width), shifted / (2.0 * step), wider / (2.0 * step)
    np.testing.assert_allclose(filled, expected, atol=2e-3)


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
    fit, straight = (located(Model.EDGE, 1.0 - darkness, width=1.3, used=used[None], bend=b) for b in (bend, 0.0))
    assert fit.place[0] == pytest.approx(place, abs=5e-3)
    assert fit.width[0] == pytest.approx(width, rel=5e-3)
    np.testing.assert_allclose(fit.fitted[0], used * (1.0 - darkness), atol=3e-4)
    assert abs(straight.place[0] - place) > 0.02
    tiny = [located(Model.EDGE, drawn(Model.EDGE, 0.4, 1.5), width=1.0, bend=b).place[0] for b in (0.0, 1e-17, 1e-3)]
    assert tiny == pytest.approx([0.4] * 3, abs=5e-3)


def test_the_place_moves_by_twelve_steps_of_at_most_a_pixel():
    """A broad line is followed from afar; one that is further off than that is not reached."""
    samples, width = np.arange(-40.0, 41.0), np.array([9.0])
    for far, reached in ((9.5, True), (12.5, False)):
        line = 0.9 - 0.4 * np.exp(-0.5 * ((samples - far) / width) ** 2)
        fit = locate(line[None], samples, Model.LINE, np.zeros(1), width, np.ones((1, len(samples))))
        assert fit.converged[0] == reached
        assert fit.place[0] == pytest.approx(far if reached else 12.0, abs=1e-3)


@every_model
def test_it_comes_from_afar_whatever_the_light_and_what_is_not_used(model):
    fit = located(model, drawn(model, 1.7, 1.6), place=-0.5, width=2.2)
    assert fit.converged[0]
    assert fit.place[0] == pytest.approx(1.7, abs=2e-3)
    profile, used = drawn(model, 0.3, 1.4), np.ones((1, len(SAMPLES)))
    plain, other = located(model, profile), located(model, 0.3 + 0.6 * profile)
    assert other.place[0] == pytest.approx(plain.place[0], abs=1e-4)
    assert other.place_variance[0] == pytest.approx(plain.place_variance[0] / 0.36, rel=1e-3)
    used[0, [0, 1, 17, 18]] = 0.0
    fit, other = (located(model, each, used=used) for each in (profile, np.where(used == 0.0, 5.0, profile)))
    assert other.place[0] == fit.place[0] == pytest.approx(0.3, abs=2e-3)
    assert fit.place_variance[0] > plain.place_variance[0]


@every_model
def test_the_variance_of_the_place_is_that_of_noisy_profiles(model):
    noise, rng = 0.005, np.random.default_rng(5)
    fit = located(model, drawn(model, 0.2, 1.5) + noise * rng.standard_normal((400, len(SAMPLES))))
    assert fit.converged.mean() > 0.98
    assert np.var(fit.place[fit.converged]) == pytest.approx(noise**2 * np.median(fit.place_variance), rel=0.25)


def test_widths_stay_in_their_bounds_and_a_wild_profile_does_not_converge():
    fit = located(Model.EDGE, np.random.default_rng(1).standard_normal((50, len(SAMPLES))))
    assert fit.width.min() >= 0.3
    assert fit.width.max() <= 12.0
    assert not fit.converged.all()
    sharp = located(Model.EDGE, np.where(SAMPLES > 0.5, 0.5, 1.0))
    assert sharp.width[0] == pytest.approx(0.3)
    assert sharp.place[0] == pytest.approx(0.5, abs=0.5)


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


def test_the_misfit_of_an_arc_is_that_of_its_neighbours_too_around_the_curve():
    left, used, variance = RANDOM.uniform(size=(9, 8)), np.ones((9, 8)), RANDOM.uniform(1.0, 2.0, 9)
    used[3] = [1, 1, 0, 0, 0, 0, 0, 0]  # less than what is fitted: no degree of freedom
    squares, free = np.sum(used * left**2, axis=1), np.where(np.arange(9) == 3, 0.0, 3.0)
    around = [np.arange(number - 2, number + 3) % 9 for number in range(9)]
    expected = [np.sqrt(squares[n].sum() / free[n].sum() * v) for n, v in zip(around, variance, strict=True)]
    np.testing.assert_allclose(misfit_around(left, used, variance, 5.0, 2), expected)


X = np.linspace(-1.0, 1.0, 41)
DESIGN = np.stack([np.ones_like(X), X], axis=1)


def fit(values, *, design=DESIGN, floor=0.01, enough=2, rounds=3, kept=None):
    kept = np.ones(len(design), bool) if kept is None else kept
    return fit_without_outliers(
        design, values, kept, rounds=rounds, floor=floor, enough=lambda kept: kept.sum() >= enough
    )


def test_outliers_are_left_out_and_points_within_four_floors_stay():
    values = 2.0 - 0.5 * X
    values[[3, 30]] += [5.0, -1.0]
    line = fit(values)
    assert line.coefficients == pytest.approx([2.0, -0.5])
    np.testing.assert_array_equal(np.flatnonzero(~line.kept), [3, 30])
    assert line.variance == pytest.approx(0.0, abs=1e-20)
    assert line.spread == 0.01
    assert line.design.shape == (39, 2)
    for off, stays in ((0.035, True), (0.05, False)):
        assert fit(2.0 - 0.5 * X + off * (np.arange(41) == 20)).kept[20] == stays


def test_too_few_points_that_are_left_by_the_last_round_are_none():
    values = np.where(np.isin(np.arange(41), [3, 30]), 5.0, 0.0)
    assert fit(values, rounds=1, enough=39).kept.sum() == 39
    assert fit(values, rounds=1, enough=40) is None


def test_variance_and_cofactor_are_those_of_ordinary_least_squares():
    """Unbiased over many lines with noise; of the line through (0, 0), (1, 1) and (2, 0), 1/3, two thirds are left."""
    rng = np.random.default_rng(2)
    lines = [fit(1.0 + 0.1 * rng.standard_normal(len(X)), floor=1.0) for _ in range(400)]
    assert np.mean([line.variance for line in lines]) == pytest.approx(0.01, rel=0.05)
    scatter = np.cov([line.coefficients for line in lines], rowvar=False)
    np.testing.assert_allclose(0.01 * lines[0].cofactor, scatter, atol=0.15 * scatter.max())
    assert lines[0].cofactor[0, 0] == pytest.approx(1.0 / 41.0)
    three = fit(np.array([0.0, 1.0, 0.0]), design=np.vander(np.arange(3.0), 2, increasing=True), floor=1.0, rounds=1)
    assert three.coefficients == pytest.approx([1.0 / 3.0, 0.0])
    assert three.variance == pytest.approx(2.0 / 3.0)


def test_without_enough_points_there_is_no_line():
    assert fit(np.zeros(len(X)), enough=42) is None
    few = X < -0.85
    assert fit(np.zeros(len(X)), kept=few, enough=few.sum()) is not None
    assert fit(np.zeros(len(X)), kept=few, enough=few.sum() + 1) is None


def test_spread_median_and_quantiles_are_those_of_numpy_and_few_values_as_wide_as_students_interval():
    errors = 3.0 * np.random.default_rng(1).standard_normal(100_000)
    assert robust_spread(errors) == pytest.approx(3.0, rel=0.02)
    assert robust_spread(np.concatenate([errors, np.full(1000, 1e6)])) == pytest.approx(3.0, rel=0.04)
    for count in (1, 2, 40, 41):
        assert median(errors[:count]) == pytest.approx(np.median(errors[:count]), abs=1e-14)
        for share in (0.0, 0.1, 0.75, 1.0):
            assert quantile(errors[:count], share) == pytest.approx(np.quantile(errors[:count], share), abs=1e-14)
    factors = [wider_by_few(free) for free in (0, 1, 4, 10, 10_000)]
    np.testing.assert_allclose(1.96 * np.array(factors), [12.706, 12.706, 2.776, 2.228, 1.960], rtol=1e-3)


RADIUS, COUNT = 40.0, 200


def circle(start=0.0):
    angle = start + 2.0 * np.pi * np.arange(COUNT) / COUNT
    return RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("start", [0.0, 0.4, 3.0])
@pytest.mark.parametrize("half", [5.0, 20.0])
def test_the_bridge_of_a_circle_lies_on_the_circle(start, half):
    curve = circle(start)
    points, bridge = bridged(curve, within(curve, np.array([[RADIUS - 15.0, -half, RADIUS + 15.0, half]])))
    np.testing.assert_allclose(np.hypot(*points.T), RADIUS, atol=0.02 if half < 10.0 else 0.2)
    assert np.abs(points[bridge, 1]).max() < half + 1.3
    apart = np.abs(points[~bridge, None] - curve).sum(axis=2).min(axis=1)
    assert np.all(apart == 0.0)
    assert np.hypot(*np.diff(points, axis=0, append=points[:1]).T).max() < 1.6


def test_two_stretches_are_bridged_each_none_stays_and_of_little_nothing_is_left():
    boxes = np.array([[30.0, -10.0, 50.0, 10.0], [-50.0, -10.0, -30.0, 10.0]])
    points, bridge = bridged(circle(), within(circle(), boxes))
    assert np.count_nonzero(bridge & ~np.roll(bridge, 1)) == 2
    np.testing.assert_allclose(np.hypot(*points.T), RADIUS, atol=0.1)
    points, bridge = bridged(circle(), np.zeros(COUNT, dtype=bool))
    np.testing.assert_array_equal(points, circle())
    assert not bridge.any()
    assert bridged(circle(), np.arange(COUNT) > 30) is None


def test_the_error_of_a_bridge_grows_with_its_height_and_is_zero_elsewhere():
    short, long = ((np.abs(circle()[:, 1]) < half) & (circle()[:, 0] > 0.0) for half in (6.0, 20.0))
    few, many = (bridge_errors(circle(), erased) for erased in (short, long))
    assert np.all(few[~short] == 0.0)
    height = RADIUS - np.sqrt(RADIUS**2 - 20.0**2)
    assert many[long] == pytest.approx(np.hypot(0.25, height), rel=0.15)
    assert np.all((few[short] > 0.25) & (few[short] < 0.2 * many[long].max()))
