"""A positive quantity as masses on a uniform grid of its logarithm: products become convolutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.infer.marginal import Marginal

__all__ = ["LogGrid"]

Floats = NDArray[np.float64]

CELLS_PER_SD = 16  # of the grid a density is laid on: the sum's error is far below the printed digits


@dataclass(frozen=True, eq=False)
class LogGrid:
    """Distribution of a positive quantity x.

    Parameters
    ----------
    start : float
        Logarithm of x at the first grid point.
    step : float
        Distance of the grid points; any positive number for a single point.
    masses : (m,) array
        Probabilities, summing to one.
    mean, variance : float
        Moments of log x before it was laid on the grid.

    Examples
    --------
    >>> product = LogGrid.known(2.0).times(LogGrid.known(3.0))
    >>> round(product.marginal().median, 9)
    6.0
    """

    start: float
    step: float
    masses: Floats
    mean: float
    variance: float

    @classmethod
    def known(cls, value: float) -> LogGrid:
        """A number without error."""
        return cls(float(np.log(value)), 1.0, np.ones(1), float(np.log(value)), 0.0)

    @classmethod
    def normal(cls, variance: float) -> LogGrid:
        """A factor about one whose logarithm is normal."""
        if variance <= 0.0:
            return cls.known(1.0)
        step = float(np.sqrt(variance)) / CELLS_PER_SD
        logs = step * np.arange(-8 * CELLS_PER_SD, 8 * CELLS_PER_SD + 1)
        masses = np.exp(-0.5 * logs**2 / variance)
        return cls(float(logs[0]), step, masses / masses.sum(), 0.0, variance)

    @classmethod
    def of_nodes(cls, logs: Floats, weights: Floats, step: float) -> LogGrid:
        """Weighted nodes, each shared linearly between its two grid points.

        Parameters
        ----------
        logs : (n,) array
            Logarithms of x.
        weights : (n,) array
            Probabilities, summing to one.
        step : float
            Distance of the grid points; at least the distance of the nodes,
            or the masses come out as a comb.
        """
        mean = float(weights @ logs)
        variance = float(weights @ (logs - mean) ** 2)
        low = float(logs.min())
        if logs.max() - low < 1e-14 * max(1.0, abs(low)):
            return cls(mean, 1.0, np.ones(1), mean, 0.0)
        position = (logs - low) / step
        left = position.astype(np.int64)
        share = position - left
        size = int(left.max()) + 2
        masses = np.bincount(left, weights * (1.0 - share), size) + np.bincount(left + 1, weights * share, size)
        return cls(low, step, masses / masses.sum(), mean, variance)

    @classmethod
    def mixed(cls, parts: Sequence[LogGrid], weights: Floats) -> LogGrid:
        """One of several distributions, each with its probability.

        Parameters
        ----------
        parts : sequence of LogGrid
        weights : (n,) array
            Probabilities, summing to one.
        """
        means = np.array([part.mean for part in parts])
        mean = float(weights @ means)
        variance = float(weights @ (np.array([part.variance for part in parts]) + (means - mean) ** 2))
        steps = [part.step for part in parts if len(part.masses) > 1]
        logs = np.concatenate([part.logs for part in parts])
        masses = np.concatenate([weight * part.masses for weight, part in zip(weights, parts, strict=True)])
        laid = cls.of_nodes(logs, masses, max(steps, default=np.sqrt(variance) / CELLS_PER_SD))
        return cls(laid.start, laid.step, laid.masses, mean, variance)

    @property
    def logs(self) -> Floats:
        """Grid points : (m,) array."""
        return np.asarray(self.start + self.step * np.arange(len(self.masses)), dtype=np.float64)

    @property
    def end(self) -> float:
        """Logarithm of x at the last grid point."""
        return self.start + self.step * (len(self.masses) - 1)

    @property
    def _edges(self) -> Floats:
        return np.concatenate([self.logs, [self.end + self.step]]) - 0.5 * self.step

    def resampled(self, step: float) -> LogGrid:
        """The same distribution on another grid."""
        if len(self.masses) == 1 or step == self.step:
            return self if len(self.masses) > 1 else LogGrid(self.start, step, self.masses, self.mean, self.variance)
        other = LogGrid.of_nodes(self.logs, self.masses, step)
        return LogGrid(other.start, step, other.masses, self.mean, self.variance)

    def times(self, other: LogGrid) -> LogGrid:
        """Product with an independent quantity."""
        if len(self.masses) == 1 or len(other.masses) == 1:
            step = other.step if len(self.masses) == 1 else self.step
        else:
            step = max(self.step, other.step)
        a, b = self.resampled(step), other.resampled(step)
        masses = np.convolve(a.masses, b.masses)
        return LogGrid(a.start + b.start, step, masses, self.mean + other.mean, self.variance + other.variance)

    def inverse(self) -> LogGrid:
        """Distribution of 1/x."""
        return LogGrid(-self.end, self.step, self.masses[::-1], -self.mean, self.variance)

    def cut(self, low: float, high: float) -> LogGrid:
        """Distribution given low <= x <= high; unchanged if nothing lies outside."""
        kept = np.where((self.logs >= np.log(low)) & (self.logs <= np.log(high)), self.masses, 0.0)
        total = kept.sum()
        if total == 1.0 or total <= 0.0 or np.array_equal(kept, self.masses):
            return self
        masses = kept / total
        mean = float(masses @ self.logs)
        return LogGrid(self.start, self.step, masses, mean, float(masses @ (self.logs - mean) ** 2))

    def below(self, logs: Floats) -> Floats:
        """Probability that log x is below each value, linear within a cell of the grid : (n,) array."""
        if len(self.masses) == 1:
            return (logs >= self.start).astype(float)
        edges = self._corrected(self._edges)
        return np.interp(logs, edges, np.concatenate([[0.0], np.cumsum(self.masses)]), left=0.0, right=1.0)

    def drawn(self, rng: np.random.Generator, count: int) -> Floats:
        """Independent draws of x : (count,) array, spread within the cells."""
        if len(self.masses) == 1:
            return np.full(count, np.exp(self.mean))
        index = rng.choice(len(self.masses), size=count, p=self.masses)
        return np.exp(self._corrected(self.start + self.step * (index + rng.uniform(-0.5, 0.5, count))))

    def marginal(self) -> Marginal:
        """Mean, standard deviation and quantiles of x."""
        if len(self.masses) == 1:
            return Marginal.known(float(np.exp(self.mean)))
        edges = self._corrected(self._edges)
        low, middle, high = np.exp(edges[:-1]), np.exp(0.5 * (edges[1:] + edges[:-1])), np.exp(edges[1:])
        mean = float(self.masses @ (low + 4.0 * middle + high)) / 6.0  # Simpson's rule within each cell
        squares = (low - mean) ** 2 + 4.0 * (middle - mean) ** 2 + (high - mean) ** 2
        sd = float(np.sqrt(self.masses @ squares / 6.0))
        return Marginal(mean, sd, *(float(value) for value in np.exp(self._quantiles(edges))))

    def log_marginal(self) -> Marginal:
        """Mean, standard deviation and quantiles of log x."""
        if len(self.masses) == 1:
            return Marginal.known(self.mean)
        quantiles = self._quantiles(self._corrected(self._edges))
        return Marginal(self.mean, float(np.sqrt(self.variance)), *(float(value) for value in quantiles))

    def _quantiles(self, edges: Floats) -> Floats:
        return np.interp(Marginal.LEVELS, np.concatenate([[0.0], np.cumsum(self.masses)]), edges)

    def _corrected(self, logs: Floats) -> Floats:
        """Undo the slight widening by the grid: give the grid the moments of the quantity itself."""
        grid = self.logs
        mean = float(self.masses @ grid)
        spread = float(self.masses @ (grid - mean) ** 2) + self.step**2 / 12.0
        return self.mean + (logs - mean) * np.sqrt(self.variance / spread)
