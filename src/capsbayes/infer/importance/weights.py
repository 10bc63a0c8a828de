"""Quasi-random draws and their weights: the effective number, the heaviness of the tail, rows by weight."""

from __future__ import annotations

import warnings

import numpy as np

from capsbayes.arrays import Floats, Integers


def normalised(log_weights: Floats) -> Floats:
    """Return weights that sum to one : (n,) array; a log of -inf is a weight of zero."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def effective(weights: Floats) -> float:
    """Return the effective number of draws with weights that sum to one (Kish)."""
    return 1.0 / float(np.sum(weights**2))


def tempering(log_weights: Floats, least: float) -> float:
    """Return the largest power, at most one, at which the weights have an effective number of at least `least`."""
    if effective(normalised(log_weights)) >= least:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(normalised(middle * log_weights)) >= least else (low, middle)
    return low


def tempered(log_weights: Floats, least: float) -> Floats:
    """Return the weights to a power that leaves an effective number of at least `least`, if there are as many."""
    return normalised(tempering(log_weights, least) * log_weights)


def rows_by_weight(weights: Floats, rng: np.random.Generator, count: int) -> Integers:
    """Return rows, each as often as its weight says, give or take one : (count,) array, rising."""
    places = (np.arange(count) + rng.uniform(size=count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)


def quasi_random(dimensions: int, count: int, seed: int, after: int = 0) -> Floats:
    """Return a part of a quasi-random sequence in the unit cube : (count, dimensions) array."""
    from scipy.stats import qmc  # half a second to import

    sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(abs(2 * seed + (seed < 0))))
    if after:
        sequence.fast_forward(after)
    return np.clip(sequence.random(count), 1e-12, 1.0 - 1e-12)


def smoothed(log_weights: Floats) -> tuple[Floats, float]:
    """Return log weights whose tail is that of a generalised Pareto distribution fitted to it, and its shape k.

    Means by the weights have a finite variance for k below 1/2, and a usable one up to 0.7; k is infinite where they
    are too few.

    Parameters
    ----------
    log_weights : (n,) array
        Those of -inf do not count among the tail.

    References
    ----------
    Vehtari, Simpson, Gelman, Yao, Gabry 2024, J. Mach. Learn. Res. 25, 72.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ArviZ itself
        import arviz  # slow to import

        found, shape = arviz.psislw(log_weights)
    return np.asarray(found), float(shape)


def pareto_shape(log_weights: Floats) -> float:
    """Return the shape k of the tail of the weights, see `smoothed`."""
    return smoothed(log_weights)[1]
