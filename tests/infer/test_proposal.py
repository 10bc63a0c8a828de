from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from capsbayes.infer.proposal import Draws, Proposal, effective, normalised, of_mixture, smoothed, tempering

COUNT = 2**13


@pytest.fixture(scope="module")
def points():
    """About a curved sheet in four dimensions: the first two columns by the others, with little scatter."""
    rng = np.random.default_rng(5)
    others = rng.standard_normal((COUNT, 2))
    first = 0.3 * others[:, 0] ** 2 - others[:, 1] + 0.02 * rng.standard_normal(COUNT)
    second = 0.5 * first * others[:, 1] + 0.01 * rng.standard_normal(COUNT)
    return np.column_stack([first, second, others])


@pytest.fixture(scope="module")
def proposal(points):
    return Proposal.fitted(points, np.full(COUNT, 1.0 / COUNT))


def log_target(points):
    first, second, x, y = points.T
    square = ((first - 0.3 * x**2 + y) / 0.02) ** 2 + ((second - 0.5 * first * y) / 0.01) ** 2 + x**2 + y**2
    return -0.5 * square - np.log(0.02 * 0.01) - 2.0 * np.log(2.0 * np.pi)


def test_points_are_flattened_and_raised_again(proposal, points):
    flat = proposal.sheet.flattened(points)
    np.testing.assert_allclose(proposal.sheet.raised(flat), points, atol=1e-12)
    thin = np.sort(np.median(np.abs(flat), axis=0))[:2]
    assert np.all(thin < 0.1)  # the scatter about the sheet; the columns themselves spread by one


def test_its_draws_weighted_by_its_density_integrate_the_target(proposal):
    draws = proposal.drawn(qmc.Sobol(6, rng=np.random.default_rng(1)).random(COUNT))
    logs = log_target(draws) - proposal.log_density(draws)
    assert np.mean(np.exp(logs)) == pytest.approx(1.0, abs=0.05)
    assert effective(normalised(logs)) > 0.3 * COUNT


def test_draws_of_two_proposals_are_draws_of_their_mixture(proposal, points):
    class Nothing(NamedTuple):
        def joined(self, other):
            return self

    # the other proposal knows half of the target; its draws alone miss what the mixture has
    half = Proposal.fitted(some := points[points[:, 2] > 0.3], np.full(len(some), 1.0 / len(some)))
    parts = []
    for one, seed in ((half, 1), (proposal, 2)):
        drawn = one.drawn(qmc.Sobol(6, rng=np.random.default_rng(seed)).random(COUNT))
        parts.append((one, Draws(drawn, log_target(drawn), one.log_density(drawn), Nothing())))
    alone, both = parts[0][1], of_mixture(parts)
    assert np.mean(np.exp(both.log_weights)) == pytest.approx(1.0, abs=0.05)
    assert effective(normalised(both.log_weights)) > 2.0 * effective(normalised(alone.log_weights))
    assert of_mixture(parts[:1]) is alone


def test_the_middle_is_one_of_the_points_near_their_mean(proposal, points):
    middle = proposal.middle(points, np.full(COUNT, 1.0 / COUNT))
    assert np.any(np.all(points == middle, axis=1))
    assert np.abs(middle[2:]).max() < 0.5


@pytest.mark.parametrize("shape", [0.2, 0.6, 1.0])
def test_the_shape_of_the_tail_is_that_of_the_distribution(shape):
    """Quantiles of generalised Pareto distributions."""
    logs = np.log(stats.genpareto(shape).ppf((np.arange(50_000) + 0.5) / 50_000))
    assert smoothed(logs)[1] == pytest.approx(shape, abs=0.1)


def test_weights_of_zero_are_no_tail():
    logs = np.random.default_rng(2).standard_normal(4000)
    assert smoothed(np.append(logs, np.full(500, -np.inf)))[1] < 0.7
    assert smoothed(np.append(np.zeros(3), np.full(500, -np.inf)))[1] == np.inf


def test_effective_draws_of_known_weights():
    assert effective(normalised(np.zeros(50))) == pytest.approx(50.0)
    assert effective(normalised(np.array([0.0, -np.inf, -800.0]))) == pytest.approx(1.0)


def test_the_power_leaves_as_many_effective_draws_as_asked_for():
    logs = -0.5 * np.random.default_rng(3).uniform(-40.0, 40.0, 5000) ** 2
    power = tempering(logs, 1000.0)
    assert 0.0 < power < 1.0
    assert effective(normalised(power * logs)) == pytest.approx(1000.0, rel=1e-3)
    assert tempering(logs, 2.0) == 1.0
