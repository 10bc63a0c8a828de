"""The compiled formulas against the general rules of which they are cases."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import multivariate_normal

from capsbayes.infer.likelihood import (
    FlowRate,
    LengthsLikelihood,
    ModelAtPoints,
    border_steps,
    feature_in_cells,
    given_flow,
    p_value,
    p_values_of_lengths,
    resolution,
    sd_in_cells,
)
from capsbayes.measurement import Measurement

WIDTH = 25e-6


@pytest.fixture
def points(model):
    theta = {"capillary_number": np.array([0.03, 0.08, 0.082]), "size_ratio": np.array([0.9, 0.95, 0.96])}
    return model(theta)


def measured(**changes):
    good = {
        "axial_extent": 2.13,
        "axial_extent_error": 0.02,
        "axial_length": 1.80,
        "axial_length_error": 0.01,
        "length_correlation": 0.4,
        "capsule_velocity": 5e-3,
        "capsule_velocity_error": 5e-5,
    }
    return Measurement(**(good | changes))


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_both_lengths_with_the_covariances_of_measurement_and_model(points, scale):
    seen = measured()
    density = LengthsLikelihood.of(seen).log_density(ModelAtPoints.of(points, error_scale=scale))
    for n, value in enumerate(density):
        covariance = seen.covariance + scale**2 * points.covariance[n, :2, :2]
        assert value == pytest.approx(multivariate_normal(points.values[n, :2], covariance).logpdf(seen.lengths))


def test_a_missing_length_leaves_the_other(points):
    seen = measured(axial_length=None, axial_length_error=None)
    density = LengthsLikelihood.of(seen).log_density(ModelAtPoints.of(points))
    exact = multivariate_normal(points.axial_extent[1], 0.02**2 + points.covariance[1, 0, 0]).logpdf(2.13)
    assert density[1] == pytest.approx(exact)


def test_lengths_in_metres_have_a_density_in_metres(points):
    lengths = {name: WIDTH * value for name, value in (("axial_extent", 2.13), ("axial_length", 1.80))}
    errors = {"axial_extent_error": 0.02 * WIDTH, "axial_length_error": 0.01 * WIDTH}
    seen = measured(**lengths, **errors, over_half_width=False)
    width = np.array([24e-6, 25e-6, 26e-6])
    density = LengthsLikelihood.of(seen).log_density(ModelAtPoints.of(points), width)
    for n, value in enumerate(density):
        mean = width[n] * np.array([points.axial_extent[n], points.axial_length[n]])
        covariance = 1e10 * (seen.covariance + width[n] ** 2 * points.covariance[n, :2, :2])
        exact = multivariate_normal(1e5 * mean, covariance).logpdf(1e5 * seen.lengths) + 2.0 * np.log(1e5)
        assert value == pytest.approx(exact)


@pytest.mark.parametrize("both", [True, False])
def test_what_the_lengths_reveal_of_the_velocity_ratio(points, both):
    """Conditional mean and variance of a joint Gaussian of measured lengths and true velocity ratio."""
    seen = measured() if both else measured(axial_length=None, axial_length_error=None)
    k = 2 if both else 1
    mean, variance = LengthsLikelihood.of(seen).velocity_ratio(ModelAtPoints.of(points))
    for n in range(3):
        model_error = points.covariance[n]
        of_lengths = seen.covariance + model_error[:k, :k]
        gain = np.linalg.solve(of_lengths, model_error[:k, 2])
        misfit = seen.lengths - points.values[n, :k]
        assert mean[n] == pytest.approx(points.velocity_ratio[n] + gain @ misfit)
        assert variance[n] == pytest.approx(model_error[2, 2] - gain @ model_error[:k, 2])


def test_the_distance_is_counted_in_standard_deviations(points):
    seen = measured(axial_length=None, axial_length_error=None)
    distance = LengthsLikelihood.of(seen).distance(ModelAtPoints.of(points))
    error = np.sqrt(0.02**2 + points.covariance[:, 0, 0])
    np.testing.assert_allclose(distance, np.abs(2.13 - points.axial_extent) / error)


def test_the_error_of_the_half_width_widens_lengths_over_l():
    seen = measured(axial_extent=2.0 * WIDTH, axial_length=1.5 * WIDTH, axial_extent_error=1e-9,
                    axial_length_error=1e-9, over_half_width=False)  # fmt: skip
    over = LengthsLikelihood.of(seen).with_half_width(WIDTH, 0.01 * WIDTH)
    assert over.over_half_width
    assert np.sqrt(over.zz) == pytest.approx(0.02, rel=1e-4)
    assert np.sqrt(over.aa) == pytest.approx(0.015, rel=1e-4)
    assert over.za == pytest.approx(0.02 * 0.015, rel=1e-4)


def test_a_flow_rate_conditions_the_inputs_as_one_linear_equation_among_normal_numbers():
    """Log Q + log r - log v - 2 log l = log A, of four independent numbers; U = v / r."""
    velocity, width, rate, ratio = 0.01, 0.003, 0.02, 0.005
    equation = np.array([-1.0, -2.0, 1.0, 1.0])  # of log v, log l, log Q, log r
    prior = np.diag([velocity, width, rate, ratio])
    gain = prior @ equation / (equation @ prior @ equation)
    mismatch, reported = 0.2 - 0.15, np.array([[1, 0, 0, -1], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    changes, variances = given_flow(-0.15, ratio, FlowRate(0.2, velocity, width, rate))
    np.testing.assert_allclose(changes, reported @ (-gain * mismatch))
    posterior = prior - np.outer(gain, equation @ prior)
    np.testing.assert_allclose(variances, np.diag(reported @ posterior @ reported.T))


def test_a_two_sided_p_value_is_that_of_the_nearer_tail_of_the_mixture():
    one = np.ones(1)
    for score in (-1.959964, 1.959964):
        assert p_value(3.0 * one, score * one) == pytest.approx(0.05, rel=1e-6)
    assert p_value(one, 0.0 * one) == pytest.approx(1.0)
    mixed = p_value(np.array([1.8, 0.2]), np.array([2.0, -1.0]))
    assert mixed == pytest.approx(2.0 * (0.9 * stats.norm.sf(2.0) + 0.1 * stats.norm.sf(-1.0)))


def test_the_width_of_a_normal_distribution_is_counted_in_cells_by_its_spread_and_by_its_steepness():
    cells = np.arange(400)
    narrow = 7.0 * np.exp(-0.5 * ((cells - 60.3) / 5.0) ** 2)
    two = narrow + np.roll(narrow, 250)

    def feature(masses):
        return feature_in_cells(masses[None])

    assert sd_in_cells(narrow) == pytest.approx(5.0, rel=1e-6)
    assert feature(narrow) == pytest.approx(5.0, rel=0.01)
    assert sd_in_cells(two) == pytest.approx(np.hypot(125.0, 5.0), rel=1e-6)
    assert feature(two) == pytest.approx(5.0, rel=0.01)


@pytest.mark.parametrize("covariance", [[[4.0, 1.5], [1.5, 1.0]], [[1.0, -0.8], [-0.8, 3.0]], [[2.0, 2.0], [2.0, 2.0]]])
def test_steps_across_a_border_lead_half_a_standard_deviation_along_the_principal_axes(covariance):
    covariance = np.array(covariance)
    steps = border_steps(covariance)
    np.testing.assert_array_equal(steps[::2], -steps[1::2])
    assert steps[0] @ steps[2] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(np.sum(steps**2, axis=1)[::2], np.linalg.eigvalsh(covariance)[::-1] / 4.0, atol=1e-12)
    np.testing.assert_allclose(steps[::2].T @ steps[::2], covariance / 4.0, atol=1e-12)


def test_one_quantity_steps_half_a_standard_deviation_to_either_side():
    np.testing.assert_allclose(border_steps(np.array([[9.0]])), [[1.5], [-1.5]])


def test_the_length_is_predicted_by_the_shapes_that_have_the_extent():
    """Two shapes whose L_z are both as measured, the second half as surely: it counts half for L_a."""
    zero, one = np.zeros(2), np.ones(2)
    of_extent, of_length = p_values_of_lengths(one, zero, np.array([2.0, 0.0]), np.array([1.0, 4.0]), zero, one)
    assert of_extent == pytest.approx(1.0)
    tail = stats.norm.sf(2.0)
    assert of_length == pytest.approx(2.0 * (2.0 / 3.0 * tail + 1.0 / 3.0 * 0.5), rel=1e-9)


def test_the_resolution_of_planes_is_that_along_either_axis():
    i, j = np.arange(41) - 20.0, np.arange(61) - 30.0
    plane = np.exp(-0.5 * (i[:, None] / 3.0) ** 2) * np.exp(-0.5 * (j / 5.0) ** 2)
    apart = np.roll(plane, 4, axis=1)
    rows, columns = resolution(np.stack([plane, 3.0 * apart, plane]))
    np.testing.assert_allclose(rows, [3.0, 3.0], rtol=0.02)
    assert columns[0] == pytest.approx(np.sqrt(5.0**2 + 0.24 * 4.0**2), rel=0.02)
    assert columns[2] == pytest.approx(5.0, rel=0.02)
