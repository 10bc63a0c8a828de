"""Compiled twin of `capsbayes.infer.log_grid`: positive quantities as masses on a grid of their logarithm.

A distribution is four numbers and an array: start and step of the grid, mean and variance of the logarithm before it
was laid on the grid, and the masses.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from capsbayes.infer.marginal import Marginal

__all__ = ["LEVELS", "Masses", "laid", "moved", "normal", "product", "scattered", "share_between", "summarise"]

Floats = NDArray[np.float64]
Masses = tuple[float, float, float, float, Floats]  # start, step, mean, variance, masses

LEVELS = Marginal.LEVELS
_REACH, _PER_SD, _CELLS = 8.0, 4.0, 8.0

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def _deposited(logs: Floats, weights: Floats, low: float, high: float, step: float) -> Floats:
    """Masses of weighted nodes, each shared linearly between its two grid points."""
    masses = np.zeros(int((high - low) / step) + 2)
    for k in range(len(logs)):
        place = (logs[k] - low) / step
        left = int(place)
        share = place - left
        masses[left] += weights[k] * (1.0 - share)
        masses[left + 1] += weights[k] * share
    return masses


@_compiled
def laid(logs: Floats, weights: Floats, least: float) -> Masses:
    """Weighted nodes on a grid of eight points to a standard deviation.

    Parameters
    ----------
    logs, weights : (n,) arrays
        Weights sum to one.
    least : float
        Smallest step: that of the nodes themselves, or the masses come out as a comb.
    """
    mean, low, high = 0.0, np.inf, -np.inf
    for k in range(len(logs)):
        mean += weights[k] * logs[k]
        low, high = min(low, logs[k]), max(high, logs[k])
    variance = 0.0
    for k in range(len(logs)):
        variance += weights[k] * (logs[k] - mean) ** 2
    step = max(np.sqrt(variance) / _CELLS, least, 1e-12)
    return low, step, mean, variance, _deposited(logs, weights, low, high, step)


@_compiled
def scattered(centre: float, error: float, power: float, step: float) -> Masses:
    """A normal x cut at zero, its density times x^power, on a grid of log x.

    Parameters
    ----------
    centre, error : float
        Of the normal; an error of zero is a known number.
    power : float
    step : float
        Wanted of the grid; a narrower distribution has one of its own.
    """
    if error == 0.0:
        return np.log(centre), step, np.log(centre), 0.0, np.ones(1)
    own = min(step, error / centre / _PER_SD)
    low = np.log(max(centre - _REACH * error, 1e-4 * centre))
    count = int(np.ceil((np.log(centre + _REACH * error) - low) / own)) + 1
    masses = np.empty(count)
    for k in range(count):
        log = low + own * k
        masses[k] = np.exp(-0.5 * ((np.exp(log) - centre) / error) ** 2 + (power + 1.0) * log)
    mean, variance = _normalised(low, own, masses)
    return low, own, mean, variance, masses


@_compiled
def normal(variance: float, step: float) -> Masses:
    """A factor about one whose logarithm is normal."""
    if variance <= 0.0:
        return 0.0, step, 0.0, 0.0, np.ones(1)
    own = min(step, np.sqrt(variance) / _PER_SD)
    count = 2 * int(np.ceil(_REACH * np.sqrt(variance) / own)) + 1
    low = -own * (count // 2)
    masses = np.empty(count, np.float64)
    for k in range(count):
        masses[k] = np.exp(-0.5 * (low + own * k) ** 2 / variance)
    _normalised(low, own, masses)
    return low, own, 0.0, variance, masses


@_compiled
def moved(one: Masses, log: float) -> Masses:
    """The quantity times a known factor."""
    return one[0] + log, one[1], one[2] + log, one[3], one[4]


@_compiled
def share_between(one: Masses, low: float, high: float) -> float:
    """Probability that log x lies between two values, by whole points of the grid."""
    share = 0.0
    for k in range(len(one[4])):
        if low <= one[0] + one[1] * k <= high:
            share += one[4][k]
    return share


@_compiled
def _normalised(start: float, step: float, masses: Floats) -> tuple[float, float]:
    """Make masses sum to one; their mean and variance."""
    total, mean, variance = masses.sum(), 0.0, 0.0
    for k in range(len(masses)):
        masses[k] /= total
        mean += masses[k] * (start + step * k)
    for k in range(len(masses)):
        variance += masses[k] * (start + step * k - mean) ** 2
    return mean, variance


@_compiled
def _resampled(one: Masses, step: float) -> Masses:
    start, own, mean, variance, masses = one
    if len(masses) == 1:
        return start, step, mean, variance, masses
    if own == step:
        return one
    logs = np.empty(len(masses), np.float64)
    for k in range(len(masses)):
        logs[k] = start + own * k
    return start, step, mean, variance, _deposited(logs, masses, start, start + own * (len(masses) - 1), step)


@_compiled
def product(one: Masses, other: Masses) -> Masses:
    """Distribution of the product of two independent quantities."""
    if len(one[4]) == 1:
        step = other[1]
    elif len(other[4]) == 1:
        step = one[1]
    else:
        step = max(one[1], other[1])
    a, b = _resampled(one, step), _resampled(other, step)
    masses = np.zeros(len(a[4]) + len(b[4]) - 1)
    for i in range(len(a[4])):
        for k in range(len(b[4])):
            masses[i + k] += a[4][i] * b[4][k]
    return a[0] + b[0], step, one[2] + other[2], one[3] + other[3], masses


@_compiled
def summarise(one: Masses, into: Floats) -> None:
    """Mean, standard deviation and quantiles of x, as `capsbayes.infer.Marginal` has them : into (7,) array."""
    start, step, mean, variance, masses = one
    if len(masses) == 1:
        into[:] = np.exp(mean)
        into[1] = 0.0
        return
    on_grid, spread = 0.0, 0.0
    for k in range(len(masses)):
        on_grid += masses[k] * (start + step * k)
    for k in range(len(masses)):
        spread += masses[k] * (start + step * k - on_grid) ** 2
    # give the grid, which widens a little, the moments of the quantity itself
    stretch = np.sqrt(variance / (spread + step * step / 12.0))
    first = mean + (start - 0.5 * step - on_grid) * stretch
    width = step * stretch
    average, squares, edge = 0.0, 0.0, np.exp(first)
    middle, whole = np.exp(0.5 * width), np.exp(width)
    low = edge
    for k in range(len(masses)):
        average += masses[k] * low * (1.0 + 4.0 * middle + whole) / 6.0
        low *= whole
    low = edge
    for k in range(len(masses)):
        ends = (low - average) ** 2 + 4.0 * (low * middle - average) ** 2 + (low * whole - average) ** 2
        squares += masses[k] * ends / 6.0
        low *= whole
    into[0], into[1] = average, np.sqrt(squares)
    for number in range(len(LEVELS)):
        below, k = 0.0, 0
        while k < len(masses) - 1 and below + masses[k] < LEVELS[number]:
            below += masses[k]
            k += 1
        share = (LEVELS[number] - below) / masses[k] if masses[k] > 0.0 else 0.0
        into[2 + number] = np.exp(first + width * (k + share))
