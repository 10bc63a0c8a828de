import numpy as np
import pytest
from scipy.stats import qmc

from capsbayes.infer.proposal import Proposal, effective, normalised

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


def test_the_middle_is_one_of_the_points_near_their_mean(proposal, points):
    middle = proposal.middle(points, np.full(COUNT, 1.0 / COUNT))
    assert np.any(np.all(points == middle, axis=1))
    assert np.abs(middle[2:]).max() < 0.5
