import numpy as np
import pytest
from scipy import stats

from capsbayes.infer.proposal import effective, normalised, pareto_shape, tempering


@pytest.mark.parametrize("shape", [0.2, 0.6, 1.0])
def test_the_shape_of_the_tail_is_that_of_the_distribution(shape):
    """Quantiles of generalised Pareto distributions."""
    logs = np.log(stats.genpareto(shape).ppf((np.arange(50_000) + 0.5) / 50_000))
    assert pareto_shape(logs) == pytest.approx(shape, abs=0.1)


def test_weights_of_zero_are_no_tail():
    logs = np.random.default_rng(2).standard_normal(4000)
    assert pareto_shape(np.append(logs, np.full(500, -np.inf))) < 0.7
    assert pareto_shape(np.append(np.zeros(3), np.full(500, -np.inf))) == np.inf


def test_effective_draws_of_known_weights():
    assert effective(normalised(np.zeros(50))) == pytest.approx(50.0)
    assert effective(normalised(np.array([0.0, -np.inf, -800.0]))) == pytest.approx(1.0)


def test_the_power_leaves_as_many_effective_draws_as_asked_for():
    logs = -0.5 * np.random.default_rng(3).uniform(-40.0, 40.0, 5000) ** 2
    power = tempering(logs, 1000.0)
    assert 0.0 < power < 1.0
    assert effective(normalised(power * logs)) == pytest.approx(1000.0, rel=1e-3)
    assert tempering(logs, 2.0) == 1.0
