"""Convergence of walkers: R-hat between ensembles, autocorrelation time, bulk and tail effective sample size; gates.

The definitions are those of ArviZ, with which the tests compare. ArviZ itself is not used: its import takes one to two
seconds, longer than the sampling, and its R-hat takes the walkers of an ensemble for independent chains.

References
----------
Vehtari, Gelman, Simpson, Carpenter, Burkner 2021, Bayesian Analysis 16, 667,
doi:10.1214/20-BA1221.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.checks import Gate

FEWEST_ENSEMBLES = 4
LARGEST_RHAT = 1.01
FEWEST_TIMES = 50.0
LEAST_STABLE_TIME = 0.01
SMALLEST_ESS = 400.0
ACCEPTANCE = (0.1, 0.9)


def chain_gates(chain: Floats) -> list[Gate]:
    """Return the gates that need every step: R-hat, length in autocorrelation times, acceptance, stuck walkers.

    Parameters
    ----------
    chain : (steps, ensembles, walkers, d) array
        After burn-in.
    """
    steps, ensembles, walkers, dimensions = chain.shape
    flat = chain.reshape(steps, ensembles * walkers, dimensions)
    times = np.array([autocorrelation_time(flat[..., k]) for k in range(dimensions)])
    before = np.array([autocorrelation_time(flat[: int(0.95 * steps), :, k]) for k in range(dimensions)])
    rhat = max(split_rhat(chain[..., k]) for k in range(dimensions))
    moved = np.any(np.diff(chain, axis=0) != 0.0, axis=-1)
    acceptance = moved.mean(axis=(0, 2))
    stuck = int(np.count_nonzero(~moved[len(moved) // 2 :].any(axis=0)))
    unstable = float(np.max(np.abs(before / times - 1.0)))
    low, high = ACCEPTANCE
    return [
        Gate("independent ensembles", ensembles, least=FEWEST_ENSEMBLES),
        Gate("split R-hat between ensembles", rhat, most=LARGEST_RHAT),
        Gate("steps over autocorrelation time", steps / float(times.max()), least=FEWEST_TIMES),
        Gate("change of autocorrelation time over the last twentieth", unstable, most=LEAST_STABLE_TIME),
        Gate("lowest acceptance", float(acceptance.min()), least=low),
        Gate("highest acceptance", float(acceptance.max()), most=high),
        Gate("stuck walkers", stuck, most=0),
    ]


def ess_gates(draws: Mapping[str, Floats]) -> list[Gate]:
    """Return the gates on the effective sample sizes of the reported quantities that vary.

    Parameters
    ----------
    draws : mapping of (chains, draws) arrays
    """
    varying = [values for values in draws.values() if np.ptp(values) > 0.0]
    found = {"smallest bulk ESS": min(map(bulk_ess, varying)), "smallest tail ESS": min(map(tail_ess, varying))}
    return [Gate(name, value, least=SMALLEST_ESS) for name, value in found.items()]


def split_rhat(draws: Floats) -> float:
    """Return the rank-normalised R-hat between the halves of independent ensembles.

    Walkers of one ensemble are pooled: they are not independent chains.

    Parameters
    ----------
    draws : (steps, ensembles, walkers) array

    Returns
    -------
    float
    """
    half = len(draws) // 2
    scores = _normal_scores(draws[: 2 * half])
    chains = np.stack([scores[:half], scores[half:]]).transpose(0, 2, 1, 3).reshape(2 * draws.shape[1], -1)
    count = chains.shape[1]
    within = chains.var(axis=1, ddof=1).mean()
    between = count * chains.mean(axis=1).var(ddof=1)
    return float(np.sqrt((count - 1) / count + between / within / count))


def autocorrelation_time(draws: Floats) -> float:
    """Return the integrated autocorrelation time in steps, by emcee's window of five times itself.

    The covariances of the walkers are averaged, so that one that never moves counts as such.

    Parameters
    ----------
    draws : (steps, chains) array
    """
    correlation = _autocovariance(draws.T).mean(axis=0)
    times = 2.0 * np.cumsum(correlation / correlation[0]) - 1.0
    window = np.flatnonzero(np.arange(len(times)) >= 5.0 * times)
    return float(times[window[0] if window.size else -1])


def bulk_ess(draws: Floats) -> float:
    """Return the effective sample size of the rank-normalised draws.

    Parameters
    ----------
    draws : (chains, draws) array
    """
    return _ess(_normal_scores(_split(draws)))


def tail_ess(draws: Floats) -> float:
    """Return the smaller effective sample size of the 5 % and of the 95 % quantile.

    Parameters
    ----------
    draws : (chains, draws) array
    """
    halves = _split(draws)
    low, high = np.quantile(halves, [0.05, 0.95])
    return min(_ess((halves <= low).astype(float)), _ess((halves <= high).astype(float)))


def _split(draws: Floats) -> Floats:
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])


def _normal_scores(draws: Floats) -> Floats:
    """Return the normal quantiles of the ranks, ties in order: repeated draws are neighbours in any case."""
    from scipy.special import ndtri

    order = np.argsort(draws, axis=None, kind="stable")
    ranks = np.empty(draws.size)
    ranks[order] = np.arange(1, draws.size + 1)
    return np.asarray(ndtri((ranks - 0.375) / (draws.size + 0.25))).reshape(draws.shape)


def _autocovariance(chains: Floats) -> Floats:
    """Return the autocovariance of each row : (chains, draws) array."""
    count = chains.shape[1]
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(chains - chains.mean(axis=1, keepdims=True), size, axis=1)
    return np.fft.irfft(np.abs(spectrum) ** 2, size, axis=1)[:, :count] / count


def _ess(chains: Floats) -> float:
    """Return the effective sample size by Geyer's initial monotone sequence, differences between chains included."""
    number, count = chains.shape
    covariance = _autocovariance(chains).mean(axis=0)
    within = covariance[0] * count / (count - 1.0)
    plus = within * (count - 1.0) / count + (chains.mean(axis=1).var(ddof=1) if number > 1 else 0.0)
    if not plus > 0.0:
        return float(number * count)
    rho = 1.0 - (within - covariance) / plus
    rho[0] = 1.0
    pairs = rho[: count // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    kept = np.minimum.accumulate(pairs[: negative[0] if negative.size else None])
    tau = max(-1.0 + 2.0 * float(kept.sum()), 1.0 / np.log10(number * count))
    return number * count / tau
