"""Positive quantities as probabilities on a uniform grid of their logarithm: products become convolutions."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.likelihood import compiled
from capsbayes.infer.prior import Marginal
from capsbayes.quantity import Quantity

CELLS_PER_SD = 16  # of the grid a density is laid on: the sum's error is far below the printed digits
_NODES = 8.0  # cells in a standard deviation of weighted nodes
_REACH = 8.0  # standard deviations on either side
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
        return cls(float(logs[0]), step, masses, *_moments(logs, masses))

    @classmethod
    def normal(cls, variance: float) -> LogGrid:
        """Return a factor about one whose logarithm is normal."""
        variance = float(variance)
        if variance <= 0.0:
            return cls(0.0, 1e-12, np.ones(1), 0.0, 0.0)
        step = float(np.sqrt(variance)) / CELLS_PER_SD
        reach = int(np.ceil(_REACH * np.sqrt(variance) / step))
        masses = np.exp(-0.5 * (step * np.arange(-reach, reach + 1)) ** 2 / variance)
        return cls(-step * reach, step, masses / masses.sum(), 0.0, variance)

    @property
    def logs(self) -> Floats:
        """Grid points : (m,) array."""
        return np.asarray(self.start + self.step * np.arange(len(self.masses)), dtype=np.float64)

    @property
    def end(self) -> float:
        """Logarithm of x at the last grid point."""
        return self.start + self.step * (len(self.masses) - 1)

    def scaled(self, log: float) -> LogGrid:
        """Multiply by a known factor, whose logarithm is given."""
        return self._replace(start=self.start + log, mean=self.mean + log)

    def times(self, other: LogGrid) -> LogGrid:
        """Return the product with an independent quantity."""
        step = max((grid.step for grid in (self, other) if len(grid.masses) > 1), default=other.step)
        first, second = self.resampled(step), other.resampled(step)
        masses = _convolved(first.masses, second.masses)
        return LogGrid(first.start + second.start, step, masses, self.mean + other.mean, self.variance + other.variance)

    def resampled(self, step: float) -> LogGrid:
        """Return the same distribution on another grid."""
        if len(self.masses) == 1:
            return self._replace(step=step)
        if step == self.step:
            return self
        return binned(self.logs, self.masses, step)._replace(mean=self.mean, variance=self.variance)

    def below(self, logs: Floats) -> Floats:
        """Return the probability that log x is below each value, linear within a cell of the grid : (n,) array."""
        if len(self.masses) == 1:
            return (logs >= self.start).astype(float)
        return np.interp(logs, self._edges, np.concatenate([[0.0], np.cumsum(self.masses)]), left=0.0, right=1.0)

    def drawn(self, rng: np.random.Generator, count: int) -> Floats:
        """Return independent draws of x : (count,) array, spread within the cells."""
        if len(self.masses) == 1:
            return np.full(count, np.exp(self.mean))
        index = rng.choice(len(self.masses), size=count, p=self.masses)
        mean, factor = self._correction
        logs = self.start + self.step * (index + rng.uniform(-0.5, 0.5, count))
        return np.exp(self.mean + (logs - mean) * factor)

    def marginal(self) -> Marginal:
        """Return mean, standard deviation and quantiles of x."""
        quantiles = np.exp(self._quantiles).tolist()
        if len(self.masses) == 1:
            return Marginal(quantiles[0], 0.0, *quantiles)
        edges = np.exp(self._edges)
        low, middle, high = edges[:-1], np.sqrt(edges[:-1] * edges[1:]), edges[1:]  # Simpson's rule within a cell
        mean = np.sum(self.masses * (low + 4.0 * middle + high)) / 6.0
        squares = np.sum(self.masses * ((low - mean) ** 2 + 4.0 * (middle - mean) ** 2 + (high - mean) ** 2)) / 6.0
        return Marginal(float(mean), float(np.sqrt(squares)), *quantiles)

    def log_marginal(self) -> Marginal:
        """Return mean, standard deviation and quantiles of log x."""
        return Marginal(self.mean, float(np.sqrt(self.variance)), *self._quantiles.tolist())

    @property
    def _correction(self) -> tuple[float, float]:
        """Mean at the grid points, and the factor on distances from it that undoes the widening by the grid."""
        mean, variance = _moments(self.logs, self.masses)
        return mean, float(np.sqrt(self.variance / (variance + self.step**2 / 12.0)))

    @property
    def _edges(self) -> Floats:
        """Edges of the cells, corrected : (m + 1,) array."""
        mean, factor = self._correction
        first = self.mean + (self.start - 0.5 * self.step - mean) * factor
        return np.asarray(first + self.step * factor * np.arange(len(self.masses) + 1))

    @property
    def _quantiles(self) -> Floats:
        """Values of log x below which the `Marginal.LEVELS` lie, linear within a cell."""
        levels = np.array(Marginal.LEVELS)
        if len(self.masses) == 1:
            return np.full(len(levels), self.mean)
        reached = np.cumsum(self.masses)
        cell = np.minimum(np.searchsorted(reached, levels), len(reached) - 1)
        share = (levels - np.where(cell > 0, reached[cell - 1], 0.0)) / np.maximum(self.masses[cell], 1e-300)
        edges = self._edges
        return np.asarray(edges[0] + (edges[1] - edges[0]) * (cell + share))


def binned(logs: Floats, weights: Floats, step: float) -> LogGrid:
    """Share weighted nodes (n,) linearly between the points of a grid; a step below their distance gives a comb."""
    return _deposited(logs, weights, step, *_moments(logs, weights))


def laid(logs: Floats, weights: Floats, least: float) -> LogGrid:
    """Share weighted nodes between the points of a grid with eight to a standard deviation, or the step `least`."""
    mean, variance = _moments(logs, weights)
    return _deposited(logs, weights, max(np.sqrt(variance) / _NODES, least, 1e-12), mean, variance)


def _deposited(logs: Floats, weights: Floats, step: float, mean: float, variance: float) -> LogGrid:
    low, high = float(logs.min()), float(logs.max())
    if high - low < 1e-14 * max(1.0, abs(low)):
        return LogGrid(mean, 1.0, np.ones(1), mean, 0.0)
    count, place = int((high - low) / step) + 2, (logs - low) / step
    left = place.astype(np.int64)
    share = place - left
    masses = np.bincount(left, weights * (1.0 - share), count) + np.bincount(left + 1, weights * share, count)
    return LogGrid(low, step, masses / masses.sum(), mean, variance)


def _moments(logs: Floats, masses: Floats) -> tuple[float, float]:
    """Return mean and variance of log x; by sums, as the digits of products of vectors depend on the BLAS kernel."""
    mean = np.sum(masses * logs)
    return float(mean), float(np.sum(masses * (logs - mean) ** 2))


@compiled
def _convolved(first: Floats, other: Floats) -> Floats:
    """Return the convolution of masses (m,) and (n,), in one order of the sum on every processor : (m + n - 1,)."""
    masses = np.zeros(len(first) + len(other) - 1)
    for i in range(len(first)):
        for k in range(len(other)):
            masses[i + k] += first[i] * other[k]
    return masses
