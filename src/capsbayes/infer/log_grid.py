"""Positive quantities as probabilities on a uniform grid of their logarithm: products become convolutions.

The functions are compiled, for loops over many capsules; the methods of `LogGrid` are their face for one.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.likelihood import compiled
from capsbayes.infer.prior import Marginal
from capsbayes.quantity import Quantity

CELLS_PER_SD = 16  # of the grid a density is laid on: the sum's error is far below the printed digits
_COARSEST = 4.0  # cells in a standard deviation of a normal factor
_NODES = 8.0  # cells in a standard deviation of weighted nodes
_REACH = 8.0  # standard deviations on either side
_LEVELS = Marginal.LEVELS
_TAIL = 1e-9  # probability beyond either end of the grid of another distribution


class LogGrid(NamedTuple):
    """Distribution of a positive quantity x."""

    start: float  # logarithm of x at the first grid point
    step: float  # distance of the grid points; any positive number for a single point
    masses: Floats  # (m,): probabilities, summing to one
    mean: float  # moments of log x before it was laid on the grid
    variance: float

    @classmethod
    def known(cls, value: float) -> LogGrid:
        """Return a number without error."""
        return cls(float(np.log(value)), 1.0, np.ones(1), float(np.log(value)), 0.0)

    @classmethod
    @functools.lru_cache(maxsize=64)  # capsules of a session share their viscosity and half width
    def of(cls, quantity: Quantity, power: int = 0) -> LogGrid:
        """Lay out a positive quantity with its density multiplied by x^power."""
        if quantity.known:
            return cls.known(quantity.value)
        if quantity.shape == "normal":
            reach = _REACH * quantity.error
            low, high = max(quantity.value - reach, 1e-4 * quantity.value), quantity.value + reach
        else:
            low, high = max(float(quantity.ppf(_TAIL)), np.finfo(float).tiny), float(quantity.distribution.isf(_TAIL))
        wide = float(np.log(high / low))
        cells = int(np.ceil(max(wide * quantity.value / quantity.error, 2.0 * _REACH) * CELLS_PER_SD))
        step = wide / cells
        logs = np.log(low) + step * (np.arange(cells) + 0.5)
        density = quantity.log_shape(np.exp(logs)) + (power + 1.0) * logs  # one power more from dx = x dlog x
        masses = np.exp(density - density.max())
        masses /= masses.sum()
        mean = float(np.sum(masses * logs))
        return cls(float(logs[0]), step, masses, mean, float(np.sum(masses * (logs - mean) ** 2)))

    @classmethod
    def normal(cls, variance: float) -> LogGrid:
        """Return a factor about one whose logarithm is normal."""
        return lognormal(float(variance), float(np.sqrt(max(variance, 0.0))) / CELLS_PER_SD)

    @property
    def logs(self) -> Floats:
        """Grid points : (m,) array."""
        return np.asarray(self.start + self.step * np.arange(len(self.masses)), dtype=np.float64)

    @property
    def end(self) -> float:
        """Logarithm of x at the last grid point."""
        return self.start + self.step * (len(self.masses) - 1)

    def times(self, other: LogGrid) -> LogGrid:
        """Return the product with an independent quantity."""
        return product(self, other)

    def below(self, logs: Floats) -> Floats:
        """Return the probability that log x is below each value, linear within a cell of the grid : (n,) array."""
        if len(self.masses) == 1:
            return (logs >= self.start).astype(float)
        first, width = _first_edge_and_width(self)
        edges = first + width * np.arange(len(self.masses) + 1)
        return np.interp(logs, edges, np.concatenate([[0.0], np.cumsum(self.masses)]), left=0.0, right=1.0)

    def drawn(self, rng: np.random.Generator, count: int) -> Floats:
        """Return independent draws of x : (count,) array, spread within the cells."""
        if len(self.masses) == 1:
            return np.full(count, np.exp(self.mean))
        index = rng.choice(len(self.masses), size=count, p=self.masses)
        mean, factor = _correction(self)
        logs = self.start + self.step * (index + rng.uniform(-0.5, 0.5, count))
        return np.exp(self.mean + (logs - mean) * factor)

    def marginal(self) -> Marginal:
        """Return mean, standard deviation and quantiles of x."""
        numbers = np.empty(2 + len(_LEVELS))
        summarise(self, numbers)
        return Marginal(*numbers.tolist())

    def log_marginal(self) -> Marginal:
        """Return mean, standard deviation and quantiles of log x."""
        quantiles = np.empty(len(_LEVELS))
        _fill_quantiles(self, quantiles)
        return Marginal(self.mean, float(np.sqrt(self.variance)), *quantiles.tolist())


@compiled
def binned(logs: Floats, weights: Floats, step: float) -> LogGrid:
    """Share weighted nodes linearly between their two grid points.

    Parameters
    ----------
    logs : (n,) array
        Logarithms of x.
    weights : (n,) array
        Probabilities, summing to one.
    step : float
        Distance of the grid points; at least the distance of the nodes, or the masses come out as a comb.
    """
    return _deposited(logs, weights, step, *_moments(logs, weights))


@compiled
def laid(logs: Floats, weights: Floats, least: float) -> LogGrid:
    """Share weighted nodes between the points of a grid with eight points to a standard deviation.

    Parameters
    ----------
    logs, weights : (n,) arrays
        As of `binned`.
    least : float
        Smallest step: that of the nodes themselves.
    """
    low, high, mean, variance = _moments(logs, weights)
    step = max(np.sqrt(variance) / _NODES, least, 1e-12)
    return _deposited(logs, weights, step, low, high, mean, variance)


@compiled
def _moments(logs: Floats, weights: Floats) -> tuple[float, float, float, float]:
    """Return the smallest and the largest of weighted nodes, their mean and their variance."""
    low, high, mean, variance = np.inf, -np.inf, 0.0, 0.0
    for k in range(len(logs)):
        low, high = min(low, logs[k]), max(high, logs[k])
        mean += weights[k] * logs[k]
    for k in range(len(logs)):
        variance += weights[k] * (logs[k] - mean) ** 2
    return low, high, mean, variance


@compiled
def _deposited(
    logs: Floats, weights: Floats, step: float, low: float, high: float, mean: float, variance: float
) -> LogGrid:
    if high - low < 1e-14 * max(1.0, abs(low)):
        return LogGrid(mean, 1.0, np.ones(1), mean, 0.0)
    masses = np.zeros(int((high - low) / step) + 2)
    for k in range(len(logs)):
        place = (logs[k] - low) / step
        left = int(place)
        share = place - left
        masses[left] += weights[k] * (1.0 - share)
        masses[left + 1] += weights[k] * share
    return LogGrid(low, step, masses / masses.sum(), mean, variance)


@compiled
def lognormal(variance: float, step: float) -> LogGrid:
    """Lay a factor about one whose logarithm is normal on a grid of this step, or of a smaller one if it is narrow."""
    if variance <= 0.0:
        return LogGrid(0.0, max(step, 1e-12), np.ones(1), 0.0, 0.0)
    own = min(step, np.sqrt(variance) / _COARSEST)
    count = 2 * int(np.ceil(_REACH * np.sqrt(variance) / own)) + 1
    low = -own * (count // 2)
    masses = np.empty(count)
    for k in range(count):
        masses[k] = np.exp(-0.5 * (low + own * k) ** 2 / variance)
    return LogGrid(low, own, masses / masses.sum(), 0.0, variance)


@compiled
def scaled(grid: LogGrid, log: float) -> LogGrid:
    """Multiply by a known factor, whose logarithm is given."""
    return LogGrid(grid.start + log, grid.step, grid.masses, grid.mean + log, grid.variance)


@compiled
def _moments_on_grid(start: float, step: float, masses: Floats) -> tuple[float, float]:
    """Return mean and variance of log x at the points of a grid."""
    logs = start + step * np.arange(len(masses))
    mean = np.sum(masses * logs)  # not a product of vectors, whose digits depend on the BLAS kernel
    return mean, np.sum(masses * (logs - mean) ** 2)


@compiled
def resampled(grid: LogGrid, step: float) -> LogGrid:
    """Return the same distribution on another grid."""
    if len(grid.masses) == 1:
        return LogGrid(grid.start, step, grid.masses, grid.mean, grid.variance)
    if step == grid.step:
        return grid
    logs: Floats = grid.start + grid.step * np.arange(len(grid.masses), dtype=np.float64)
    anew = binned(logs, grid.masses, step)
    return LogGrid(anew.start, step, anew.masses, grid.mean, grid.variance)


@compiled
def product(first: LogGrid, other: LogGrid) -> LogGrid:
    """Return the distribution of the product of two independent quantities."""
    if len(first.masses) == 1:
        step = other.step
    elif len(other.masses) == 1:
        step = first.step
    else:
        step = max(first.step, other.step)
    a, b = resampled(first, step), resampled(other, step)
    masses = np.zeros(len(a.masses) + len(b.masses) - 1)
    for i in range(len(a.masses)):
        for k in range(len(b.masses)):
            masses[i + k] += a.masses[i] * b.masses[k]
    return LogGrid(a.start + b.start, step, masses, first.mean + other.mean, first.variance + other.variance)


@compiled
def _correction(grid: LogGrid) -> tuple[float, float]:
    """Return the mean at the grid points, and the factor on distances from it that undoes the widening by the grid."""
    mean, variance = _moments_on_grid(grid.start, grid.step, grid.masses)
    return mean, np.sqrt(grid.variance / (variance + grid.step * grid.step / 12.0))


@compiled
def _first_edge_and_width(grid: LogGrid) -> tuple[float, float]:
    """Return the lower edge of the first cell and the width of the cells, corrected."""
    mean, factor = _correction(grid)
    return grid.mean + (grid.start - 0.5 * grid.step - mean) * factor, grid.step * factor


@compiled
def _fill_quantiles(grid: LogGrid, into: Floats) -> None:
    """Fill in the values of log x below which the `Marginal.LEVELS` lie, linear within a cell."""
    if len(grid.masses) == 1:
        into[:] = grid.mean
        return
    first, width = _first_edge_and_width(grid)
    for number in range(len(_LEVELS)):
        below, k = 0.0, 0
        while k < len(grid.masses) - 1 and below + grid.masses[k] < _LEVELS[number]:
            below += grid.masses[k]
            k += 1
        share = (_LEVELS[number] - below) / grid.masses[k] if grid.masses[k] > 0.0 else 0.0
        into[number] = first + width * (k + share)


@compiled
def summarise(grid: LogGrid, into: Floats) -> None:
    """Fill in mean, standard deviation and quantiles of x, as the fields of `Marginal` : (7,) array."""
    _fill_quantiles(grid, into[2:])
    for k in range(2, len(into)):  # numba takes seconds to compile an assignment of arrays
        into[k] = np.exp(into[k])
    if len(grid.masses) == 1:
        into[0], into[1] = into[2], 0.0
        return
    first, width = _first_edge_and_width(grid)
    mean, squares, low = 0.0, 0.0, np.exp(first)
    middle, whole = np.exp(0.5 * width), np.exp(width)  # from the lower edge of a cell; Simpson's rule within it
    for k in range(len(grid.masses)):
        mean += grid.masses[k] * low * (1.0 + 4.0 * middle + whole) / 6.0
        low *= whole
    low = np.exp(first)
    for k in range(len(grid.masses)):
        ends = (low - mean) ** 2 + 4.0 * (low * middle - mean) ** 2 + (low * whole - mean) ** 2
        squares += grid.masses[k] * ends / 6.0
        low *= whole
    into[0], into[1] = mean, np.sqrt(squares)
