"""Weights of draws: their effective number, and the heaviness of their tail."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats

_FEWEST_IN_TAIL = 5


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


def pareto_shape(log_weights: Floats) -> float:
    """Return the shape k of the generalised Pareto distribution of the largest weights.

    Means by the weights have a finite variance for k below 1/2, and a usable one up to 0.7.

    Parameters
    ----------
    log_weights : (n,) array
        Those of -inf do not count among the tail.

    References
    ----------
    Vehtari, Simpson, Gelman, Yao, Gabry 2024, J. Mach. Learn. Res. 25, 72: the size of the tail.
    Zhang, Stephens 2009, Technometrics 51, 316, doi:10.1198/tech.2009.08017: the fit, with the prior of the former.
    """
    logs = np.sort(log_weights[np.isfinite(log_weights)])
    count = int(np.ceil(min(0.2 * len(log_weights), 3.0 * np.sqrt(len(log_weights)))))
    if len(logs) <= max(count, _FEWEST_IN_TAIL):
        return float("inf")
    beyond = np.exp(logs[-count:] - logs[-1]) - np.exp(logs[-count - 1] - logs[-1])
    if not beyond[0] > 0.0:
        beyond = np.maximum(beyond, np.finfo(float).tiny)
    return _generalised_pareto(beyond)


def _generalised_pareto(sorted_values: Floats) -> float:
    """Return the shape of the generalised Pareto distribution of sorted positive values (n,)."""
    n = len(sorted_values)
    tried = 30 + int(np.sqrt(n))
    quarter = sorted_values[int(n / 4.0 + 0.5) - 1]
    rates = 1.0 - np.sqrt(tried / (np.arange(1, tried + 1) - 0.5))
    rates = rates / (3.0 * quarter) + 1.0 / sorted_values[-1]
    shapes = np.log1p(-rates[:, None] * sorted_values).mean(axis=1)
    likelihood = n * (np.log(-rates / shapes) - shapes - 1.0)
    rate = float(np.sum(normalised(likelihood) * rates))
    shape = float(np.log1p(-rate * sorted_values).mean())
    return (n * shape + 5.0) / (n + 10.0)  # a weak prior about one half, worth ten draws
