"""Lines with outliers."""

import numpy as np
import pytest

from capsbayes.image.edge_models import fit_without_outliers, median, quantile, robust_spread, wider_by_few

X = np.linspace(-1.0, 1.0, 41)
DESIGN = np.stack([np.ones_like(X), X], axis=1)


def fit(values, *, floor=0.01, enough=2, rounds=3, kept=None):
    kept = np.ones(len(X), bool) if kept is None else kept
    return fit_without_outliers(
        DESIGN, values, kept, rounds=rounds, floor=floor, enough=lambda kept: kept.sum() >= enough
    )


def test_the_spread_of_normal_errors_is_their_standard_deviation():
    errors = 3.0 * np.random.default_rng(1).standard_normal(100_000)
    assert robust_spread(errors) == pytest.approx(3.0, rel=0.02)
    assert robust_spread(np.concatenate([errors, np.full(1000, 1e6)])) == pytest.approx(3.0, rel=0.04)


def test_outliers_are_left_out_and_the_rest_is_a_line():
    values = 2.0 - 0.5 * X
    values[[3, 30]] += [5.0, -1.0]
    found = fit(values)
    assert found.coefficients == pytest.approx([2.0, -0.5])
    np.testing.assert_array_equal(np.flatnonzero(~found.kept), [3, 30])
    assert found.variance == pytest.approx(0.0, abs=1e-20)
    assert found.spread == 0.01
    assert found.design.shape == (39, 2)


def test_points_within_four_floors_stay():
    values = 2.0 - 0.5 * X
    values[20] += 0.035
    assert fit(values).kept.all()
    values[20] += 0.015
    assert not fit(values).kept[20]


def test_variance_and_cofactor_are_those_of_ordinary_least_squares():
    """Unbiased over many lines with noise; the error of a mean of n points is one over n."""
    rng = np.random.default_rng(2)
    found = [fit(1.0 + 0.1 * rng.standard_normal(len(X)), floor=1.0) for _ in range(400)]
    assert np.mean([one.variance for one in found]) == pytest.approx(0.01, rel=0.05)
    scatter = np.cov([one.coefficients for one in found], rowvar=False)
    np.testing.assert_allclose(0.01 * found[0].cofactor, scatter, atol=0.15 * scatter.max())
    assert found[0].cofactor[0, 0] == pytest.approx(1.0 / 41.0)


def test_without_enough_points_there_is_no_line():
    assert fit(np.zeros(len(X)), enough=42) is None
    few = X < -0.85
    assert fit(np.zeros(len(X)), kept=few, enough=few.sum()) is not None
    assert fit(np.zeros(len(X)), kept=few, enough=few.sum() + 1) is None


def test_three_points_leave_a_line_one_degree_of_freedom():
    """The line through (0, 0), (1, 1) and (2, 0) is 1/3: the squares of what is left sum to 2/3."""
    design = np.stack([np.ones(3), np.arange(3.0)], axis=1)
    fit = fit_without_outliers(
        design, np.array([0.0, 1.0, 0.0]), np.ones(3, bool), rounds=1, floor=1.0, enough=lambda kept: True
    )
    assert fit.coefficients == pytest.approx([1.0 / 3.0, 0.0])
    assert fit.variance == pytest.approx(2.0 / 3.0)


def test_fits_median_and_quantiles_are_those_of_numpy():
    values = np.random.default_rng(5).standard_normal(41)
    kept = np.abs(values) < 1.5
    made = fit(values, kept=kept, rounds=1)
    expected, *_ = np.linalg.lstsq(DESIGN[kept], values[kept], rcond=None)
    np.testing.assert_allclose(made.coefficients, expected, rtol=1e-10)
    for count in (1, 2, 40, 41):
        assert median(values[:count]) == pytest.approx(np.median(values[:count]), abs=1e-14)
        for share in (0.0, 0.1, 0.75, 1.0):
            assert quantile(values[:count], share) == pytest.approx(np.quantile(values[:count], share), abs=1e-14)


def test_errors_from_few_values_are_as_wide_as_students_interval():
    factors = [wider_by_few(free) for free in (0, 1, 4, 10, 10_000)]
    np.testing.assert_allclose(1.96 * np.array(factors), [12.706, 12.706, 2.776, 2.228, 1.960], rtol=1e-3)
