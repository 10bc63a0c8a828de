import numpy as np
import pytest
from scipy import stats

from capsbayes.infer.log_grid import LogGrid, binned, laid
from capsbayes.quantity import Quantity


def lognormal(median, sd):
    """Nodes on a grid of four cells in a standard deviation, as an engine would give them."""
    logs = np.log(median) + sd * np.arange(-6.0, 6.01, 0.25)
    weights = np.exp(-0.5 * ((logs - np.log(median)) / sd) ** 2)
    return logs, weights / weights.sum()


@pytest.mark.parametrize("other", [0.001, 0.05, 0.2])
def test_a_product_of_lognormals_is_lognormal_whatever_their_widths(other):
    logs, weights = lognormal(0.04, 0.1)
    product = binned(logs, weights, 0.025).times(LogGrid.normal(other**2))
    sd = np.hypot(0.1, other)
    assert product.log_marginal().sd == pytest.approx(sd, rel=1e-6)
    exact = stats.norm(np.log(0.04), sd)
    one = product.log_marginal()
    for end, level in (("median", 0.5), ("upper_68", 0.84), ("upper_95", 0.975)):
        assert getattr(one, end) == pytest.approx(exact.ppf(level), abs=0.01 * sd)


def test_draws_follow_the_distribution():
    logs, weights = lognormal(0.04, 0.2)
    draws = binned(logs, weights, 0.05).drawn(np.random.default_rng(2), 20_000)
    assert stats.kstest(np.log(draws), stats.norm(np.log(0.04), 0.2).cdf).pvalue > 1e-3
    assert set(LogGrid.known(3.0).drawn(np.random.default_rng(2), 4)) == {np.exp(np.log(3.0))}


LEVELS = {"lower_95": 0.025, "lower_68": 0.16, "median": 0.5, "upper_68": 0.84, "upper_95": 0.975}


def assert_is(one, exact, share=0.002):
    """Compare a marginal with a distribution, to a small share of its standard deviation."""
    assert one.mean == pytest.approx(exact.mean(), abs=share * exact.std())
    assert one.sd == pytest.approx(exact.std(), rel=2.0 * share)
    for end, level in LEVELS.items():
        assert getattr(one, end) == pytest.approx(exact.ppf(level), abs=2.0 * share * exact.std()), end


@pytest.mark.parametrize(
    ("quantity", "exact"),
    [
        (Quantity(0.85, 0.02), stats.norm(0.85, 0.02)),
        (Quantity(1.0, 0.6), stats.truncnorm(-1.0 / 0.6, np.inf, 1.0, 0.6)),
        (Quantity.uniform(2.0, 3.0), stats.uniform(2.0, 1.0)),
        (Quantity.log_uniform(1.0, 10.0), stats.loguniform(1.0, 10.0)),
    ],
    ids=["normal", "cut at zero", "uniform", "log-uniform"],
)
def test_a_quantity_is_laid_out_as_it_is_distributed(quantity, exact):
    grid = LogGrid.of(quantity)
    assert_is(grid.marginal(), exact)
    assert grid.mean == pytest.approx(exact.expect(lambda x: np.log(np.abs(x))), abs=1e-3)
    assert grid.variance == pytest.approx(exact.expect(lambda x: (np.log(np.abs(x)) - grid.mean) ** 2), rel=0.005)
    assert grid.end == pytest.approx(grid.logs[-1])
    assert np.diff(grid.logs) == pytest.approx(grid.step)
    assert grid.step < np.sqrt(grid.variance) / 10.0


@pytest.mark.parametrize("power", [-2, 1])
def test_a_power_moves_a_lognormal_quantity_by_its_variance(power):
    """The density N(log x; m, s^2) / x times x^p is that of N(log x; m + p s^2, s^2) / x."""
    grid = LogGrid.of(Quantity.log_normal(2.0, 0.4), power)
    variance = np.log1p(0.2**2)
    assert grid.mean == pytest.approx(np.log(2.0) + (power - 0.5) * variance, abs=1e-6)
    assert grid.variance == pytest.approx(variance, rel=1e-5)


def test_moments_of_a_wide_lognormal_factor_are_exact():
    for variance in (1.0, 1e-4):
        exact = stats.lognorm(np.sqrt(variance))
        factor = LogGrid.normal(variance)
        assert_is(factor.marginal(), exact, 0.001)
        assert factor.start == pytest.approx(-factor.end)
        assert factor.end > 7.0 * np.sqrt(variance)
        assert factor.step < 0.1 * np.sqrt(variance)
        scores = np.array([-50.0, -1.0, 0.0, 1.0, 50.0])
        np.testing.assert_allclose(factor.below(np.sqrt(variance) * scores), stats.norm.cdf(scores), atol=1e-3)
    np.testing.assert_array_equal(LogGrid.known(1.0).below(np.array([-0.2, 0.0, 0.2])), [0.0, 1.0, 1.0])
    none = LogGrid.normal(0.0)
    assert none.marginal().as_dict() == LogGrid.known(1.0).marginal().as_dict()
    assert none.marginal().sd == 0.0


@pytest.mark.parametrize("step", [0.1, 0.2])
def test_the_widening_by_a_coarse_grid_is_undone(step):
    """Cells of half and of a whole standard deviation."""
    logs, weights = lognormal(1.0, 0.2)
    one = binned(logs, weights, step)
    assert one.masses @ one.logs == pytest.approx(0.0, abs=1e-12)
    assert one.masses.sum() == pytest.approx(1.0)
    exact = stats.norm(0.0, 0.2)
    for end, level in LEVELS.items():
        assert getattr(one.log_marginal(), end) == pytest.approx(exact.ppf(level), abs=0.06 * 0.2), end
    tried = np.array([-0.2, 0.0, 0.2])
    np.testing.assert_allclose(one.below(tried), exact.cdf(tried), atol=0.012)
    assert np.std(np.log(one.drawn(np.random.default_rng(1), 20_000))) == pytest.approx(0.2, rel=0.02)


def test_nodes_are_laid_on_eight_cells_in_a_standard_deviation_or_on_their_own_distance():
    logs, weights = np.linspace(-1.0, 1.0, 2001), np.full(2001, 1.0 / 2001)
    sd = 1.0 / np.sqrt(3.0)
    fine, coarse = laid(logs, weights, 0.001), laid(logs, weights, 0.2)
    assert fine.step == pytest.approx(sd / 8.0, rel=1e-3)
    assert coarse.step == 0.2
    for grid in (fine, coarse):
        assert grid.mean == pytest.approx(0.0, abs=1e-12)
        assert grid.variance == pytest.approx(sd**2, rel=2e-3)
        assert grid.below(np.array([-2.0, 0.5, 2.0])) == pytest.approx([0.0, 0.75, 1.0], abs=0.01)
    one = laid(np.full(3, 0.7), np.full(3, 1.0 / 3.0), 0.001)
    assert one.marginal().as_dict() == pytest.approx(LogGrid.known(np.exp(0.7)).marginal().as_dict())


def test_a_known_factor_changes_the_numbers_and_no_probability():
    logs, weights = lognormal(4.0, 0.3)
    one = binned(logs, weights, 0.075)
    twice = one.scaled(np.log(2.0))
    np.testing.assert_allclose(twice.logs, one.logs + np.log(2.0))
    for name, value in one.marginal().as_dict().items():
        assert twice.marginal().as_dict()[name] == pytest.approx(2.0 * value), name
    moved = LogGrid.known(2.0).times(one)
    np.testing.assert_allclose(moved.masses, one.masses)
    np.testing.assert_allclose(moved.logs, twice.logs)


def test_another_grid_keeps_the_moments():
    one = LogGrid.normal(0.04)
    np.testing.assert_array_equal(one.resampled(one.step).masses, one.masses)
    other = one.resampled(3.0 * one.step)
    assert other.step == 3.0 * one.step
    assert (other.mean, other.variance) == (one.mean, one.variance)
    assert other.masses @ other.logs**2 == pytest.approx(0.04, rel=0.01)
    assert other.log_marginal().upper_95 == pytest.approx(0.2 * 1.959964, rel=0.01)
    product = one.times(LogGrid.normal(0.01))
    assert product.masses.sum() == pytest.approx(1.0)
    assert product.marginal().mean == pytest.approx(np.exp(0.025), rel=1e-4)
