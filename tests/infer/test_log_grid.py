import numpy as np
import pytest
from scipy import stats

from capsbayes.infer.log_grid import LogGrid, binned, inverse


def lognormal(median, sd):
    """Nodes on a grid of four cells in a standard deviation, as an engine would give them."""
    logs = np.log(median) + sd * np.arange(-6.0, 6.01, 0.25)
    weights = np.exp(-0.5 * ((logs - np.log(median)) / sd) ** 2)
    return logs, weights / weights.sum()


def test_nodes_of_a_lognormal_give_its_quantiles():
    logs, weights = lognormal(0.04, 0.2)
    exact = stats.lognorm(0.2, scale=0.04)
    one = binned(logs, weights, 0.25 * 0.2).marginal()
    assert one.mean == pytest.approx(exact.mean(), rel=1e-3)
    assert one.sd == pytest.approx(exact.std(), rel=2e-3)
    for end, level in (("median", 0.5), ("lower_68", 0.16), ("upper_68", 0.84), ("lower_95", 0.025)):
        assert getattr(one, end) == pytest.approx(exact.ppf(level), abs=0.01 * exact.std())


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


def test_known_numbers_multiply_exactly():
    product = inverse(LogGrid.known(2.0).times(LogGrid.known(3.0)))
    assert product.marginal().median == pytest.approx(1.0 / 6.0)
    logs, weights = lognormal(1.0, 0.1)
    one = binned(logs, weights, 0.025)
    assert one.times(LogGrid.known(5.0)).mean == pytest.approx(one.mean + np.log(5.0))


def test_an_inverse_mirrors_the_quantiles():
    logs, weights = lognormal(4.0, 0.3)
    one = binned(logs, weights, 0.075)
    assert inverse(one).marginal().median == pytest.approx(1.0 / one.marginal().median)
    assert inverse(one).marginal().upper_95 == pytest.approx(1.0 / one.marginal().lower_95)


def test_probability_below():
    one = LogGrid.normal(0.04)
    logs = np.array([-10.0, -0.2, 0.0, 0.2, 10.0])
    np.testing.assert_allclose(one.below(logs), [0.0, stats.norm.cdf(-1), 0.5, stats.norm.cdf(1), 1.0], atol=1e-3)
    np.testing.assert_array_equal(LogGrid.known(1.0).below(logs), [0.0, 0.0, 1.0, 1.0, 1.0])


def test_draws_follow_the_distribution():
    logs, weights = lognormal(0.04, 0.2)
    draws = binned(logs, weights, 0.05).drawn(np.random.default_rng(2), 20_000)
    assert stats.kstest(np.log(draws), stats.norm(np.log(0.04), 0.2).cdf).pvalue > 1e-3
    assert set(LogGrid.known(3.0).drawn(np.random.default_rng(2), 4)) == {np.exp(np.log(3.0))}
