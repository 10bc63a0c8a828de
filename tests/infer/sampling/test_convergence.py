import warnings

import numpy as np
import pytest

from capsbayes.infer.sampling import autocorrelation_time, bulk_ess, split_rhat, tail_ess


def autoregressive(rng, shape, memory):
    """Stationary first-order process along the last axis: autocorrelation time (1 + m) / (1 - m)."""
    noise = rng.standard_normal(shape)
    draws = np.empty(shape)
    draws[..., 0] = noise[..., 0]
    for k in range(1, shape[-1]):
        draws[..., k] = memory * draws[..., k - 1] + np.sqrt(1.0 - memory**2) * noise[..., k]
    return draws


@pytest.fixture(scope="module")
def arviz():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its next version once a day
        import arviz
    return arviz


@pytest.mark.parametrize("memory", [0.0, 0.7, 0.95, -0.4])
def test_effective_sample_sizes_are_those_of_arviz(arviz, memory):
    draws = np.exp(autoregressive(np.random.default_rng(8), (8, 1000), memory))
    assert bulk_ess(draws) == pytest.approx(float(arviz.ess(draws, method="bulk")), rel=1e-2)
    assert tail_ess(draws) == pytest.approx(float(arviz.ess(draws, method="tail")), rel=1e-2)


def test_rhat_is_that_of_arviz_when_ensembles_have_one_walker(arviz):
    draws = autoregressive(np.random.default_rng(9), (4, 800), 0.8)
    draws[0] += 0.3
    ours = split_rhat(draws.T[:, :, None])
    assert ours == pytest.approx(float(arviz.rhat(draws, method="z_scale")), rel=1e-6)
    assert ours > 1.01


def test_rhat_sees_an_ensemble_elsewhere_but_not_a_single_walker():
    rng = np.random.default_rng(10)
    draws = rng.standard_normal((500, 4, 16))
    assert split_rhat(draws) < 1.002
    one_walker = draws.copy()
    one_walker[:, 0, 0] += 1.0
    assert split_rhat(one_walker) < 1.01
    draws[:, 2] += 0.5
    assert split_rhat(draws) > 1.01


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_the_autocorrelation_time_of_a_known_process(memory):
    draws = autoregressive(np.random.default_rng(11), (64, 4000), memory)
    assert autocorrelation_time(draws.T) == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.06)


def test_the_autocorrelation_time_is_that_of_emcee():
    from emcee.autocorr import integrated_time

    draws = autoregressive(np.random.default_rng(12), (32, 2000), 0.8).T
    assert autocorrelation_time(draws) == pytest.approx(float(integrated_time(draws[..., None])[0]), rel=0.02)


def test_a_constant_has_as_many_draws_as_it_has():
    assert bulk_ess(np.tile(np.arange(100.0), (4, 1))) > 0.0
    assert tail_ess(np.ones((4, 100))) == 400.0
