"""The minimiser of sums of squares: certified answers, batches, borders, and independence of rounding."""

import numpy as np
import pytest

from capsbayes.least_squares import TOLERANCE, Linearised, minimise


def answered(evaluate, starts, longest=np.inf, steps=30):
    rows = np.arange(len(starts))
    return minimise(evaluate, evaluate(np.array(starts, dtype=float), rows), rows, longest, steps)


def rosenbrock(points, rows):
    x, y = points.T
    slopes = np.stack([np.stack([-20 * x, np.full_like(x, 10.0)], 1), np.stack([-np.ones_like(x), 0 * x], 1)], 1)
    return Linearised(points, np.stack([10 * (y - x**2), 1 - x], axis=1), slopes)


# Misra1a of the NIST Statistical Reference Datasets: y = b1 (1 - exp(-b2 x)), certified to eleven digits.
X = np.array([77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0])
Y = np.array([10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78])
B = (2.3894212918e02, 5.5015643181e-04)
SD = 1.0187876330e-01


def misra(points, rows):
    b1, b2 = points[:, :1], points[:, 1:]
    decay = np.exp(-b2 * X)
    return Linearised(points, (b1 * (1 - decay) - Y) / SD, np.stack([1 - decay, b1 * X * decay], axis=2) / SD)


def assert_certified(points):
    """Within a hundred-thousandth of the certified standard errors."""
    assert np.all(np.abs(points - np.array(B)) < 1e-5 * np.array([2.7070075241, 7.2668688436e-6]))


def test_the_certified_answer_is_found_from_both_certified_starts():
    found = answered(misra, [[500.0, 1e-4], [250.0, 5e-4]], steps=100)
    assert_certified(found.points)
    np.testing.assert_allclose(np.sqrt(np.linalg.inv(found.normal)[:, 0, 0]), 2.7070075241, rtol=1e-8)


def test_a_curved_valley_is_followed_to_its_end():
    np.testing.assert_allclose(answered(rosenbrock, [[-1.2, 1.0], [3.0, -4.0]], steps=100).points, 1.0, atol=1e-7)


def test_large_residuals_that_bend_take_a_few_steps():
    """y = exp(b x) and data on a falling line: more than forty steps by Gauss-Newton alone."""
    x, calls = np.linspace(0.0, 2.0, 9), []

    def bent(points, rows):
        calls.append(len(rows))
        curve = np.exp(points * x)
        return Linearised(points, curve - (3.0 - 2.0 * x), (x * curve)[..., None])

    found = answered(bent, [[0.3]])
    assert abs(found.pull[0, 0]) < 1e-5
    assert len(calls) < 12


@pytest.mark.parametrize("seed", range(5))
def test_rounding_does_not_move_the_answer(seed):
    """Residuals and slopes with errors a hundred times those of rounding: the answer moves by 1e-5 of its width."""
    rng = np.random.default_rng(seed)

    def rounded(points, rows):
        exact = misra(points, rows)
        return Linearised(
            *(values * (1 + 1e-14 * rng.standard_normal(values.shape)) for values in vars(exact).values())
        )

    exact, other = answered(misra, [[250.0, 5e-4]]), answered(rounded, [[250.0, 5e-4]])
    width = np.sqrt(np.diagonal(np.linalg.inv(exact.normal)[0]))
    assert np.all(np.abs(other.points - exact.points) < 1e-5 * width)


def test_slopes_that_are_a_little_off_do_not_end_the_steps_early():
    def off(points, rows):
        exact = misra(points, rows)
        return Linearised(points, exact.residuals, exact.slopes * (1 + 1e-4 * np.cos(np.arange(14)))[:, None])

    found = answered(off, [[250.0, 5e-4]])
    assert found.left < TOLERANCE


def test_problems_of_a_batch_do_not_touch_each_other_and_may_have_fewer_residuals():
    def some(points, rows):
        found = misra(points, rows)
        found.residuals[rows == 1, 9:] = found.slopes[rows == 1, 9:] = 0.0
        return found

    together = answered(some, [[260.0, 5e-4], [250.0, 5e-4], [250.0, 4e-4]])
    alone = answered(lambda points, rows: some(points, rows + 1), [[250.0, 5e-4]])
    np.testing.assert_allclose(together.points[1], alone.points[0], rtol=1e-12)
    assert abs(together.points[1, 0] / B[0] - 1) > 1e-3
    assert_certified(together.points[[0, 2]])


def test_a_start_that_is_not_defined_stays_and_a_step_out_of_the_domain_is_shortened():
    def bounded(points, rows):
        found = misra(points, rows)
        outside = (points[:, 0] < 238.8) | (points[:, 1] > 5.503e-4)
        found.residuals[outside] = np.nan
        return found

    found = answered(bounded, [[200.0, 5e-4], [250.0, 5e-4]])
    assert found.points[0].tolist() == [200.0, 5e-4]
    assert np.isinf(found.square[0])
    assert_certified(found.points[1])
