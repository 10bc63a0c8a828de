"""The compiled formulas against the general rules of which they are cases."""

import numpy as np
import pytest
from scipy import stats

from capsbayes.infer.likelihood import (
    Flow,
    border_steps,
    feature_in_cells,
    given_flow,
    misfits,
    p_value,
    sd_in_cells,
    velocity_ratios,
)

JOINT = np.array([[4.0, 1.0, 0.6], [1.0, 2.0, -0.5], [0.6, -0.5, 1.0]])
"""Covariance of the differences in L_z and L_a and of the model's error in v_o/U."""


def test_misfits_of_a_table_are_those_of_a_joint_normal_distribution():
    z, a = np.array([[0.5], [-1.0]]), np.array([0.3, -2.0, 0.1])
    squares, volumes = misfits(z, a, 4.0, 1.0, 2.0)
    assert squares.shape == volumes.shape == (2, 3)
    density = stats.multivariate_normal(np.zeros(2), JOINT[:2, :2])
    expected = [[density.logpdf([one, other]) for other in a] for one in z[:, 0]]
    np.testing.assert_allclose(-0.5 * (squares + np.log(volumes)), expected)


@pytest.mark.parametrize("seen", [1, 2])
def test_the_velocity_ratio_given_the_lengths_is_that_of_a_joint_normal_distribution(seen):
    lengths = np.array([0.7, -1.1])[:seen]
    gain = np.linalg.solve(JOINT[:seen, :seen], JOINT[:seen, 2])
    mean, variance = velocity_ratios(0.7, -1.1 if seen == 2 else np.nan, 4.0, 1.0, 2.0, 1.3, 0.6, -0.5, 1.0)
    assert mean == pytest.approx(1.3 + gain @ lengths)
    assert variance == pytest.approx(1.0 - gain @ JOINT[:seen, 2])


def test_a_flow_rate_conditions_the_inputs_as_one_linear_equation_among_normal_numbers():
    """Log Q + log r - log v - 2 log l = log A, of four independent numbers; U = v / r."""
    velocity, width, rate, ratio = 0.01, 0.003, 0.02, 0.005
    equation = np.array([-1.0, -2.0, 1.0, 1.0])  # of log v, log l, log Q, log r
    prior = np.diag([velocity, width, rate, ratio])
    gain = prior @ equation / (equation @ prior @ equation)
    mismatch, reported = 0.2 - 0.15, np.array([[1, 0, 0, -1], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    changes, variances = given_flow(-0.15, ratio, Flow(0.2, velocity, width, rate))
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
