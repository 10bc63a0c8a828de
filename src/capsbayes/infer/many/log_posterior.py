"""Log posterior density of a Gaussian population of (log G_s, log a): likelihood of all capsules, priors, selection.

A capsule's own likelihood is a mixture of Gaussians, so its integral over a Gaussian population is a sum of Gaussians,

    p(capsule | population) = sum_k w_k N(m_k; mu, Sigma + S_k).
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.infer.kernel import compiled
from capsbayes.infer.many.selection import Selection

PARAMETERS = ("log_modulus", "log_radius", "log_spread", "log_radius_spread", "slope")
"""Means of log G_s and log a, logarithms of the standard deviations of log G_s at given size and of log a, and the
slope d ln G_s / d ln a."""

SPREADS, SLOPES = 1.0, 5.0  # scales of the priors: half-normal of both spreads, normal of the slope
_LOWEST_SPREAD = np.log(1e-3)
_THREADS = 2


@dataclass(frozen=True, eq=False)
class LogPosterior:
    """Log posterior density of the `PARAMETERS` of a population.

    Parameters
    ----------
    components : (n, c, 6) array
        Likelihood of each capsule in (log G_s, log a).
    selection : Selection, optional
    """

    components: NDArray[np.float32]
    selection: Selection | None = None

    def __call__(self, parameters: Floats) -> Floats:
        """Return the log density of some populations, up to a constant : (d, 5) -> (d,) array."""
        parameters = np.ascontiguousarray(np.atleast_2d(parameters))
        values = np.empty(len(parameters))
        halves = np.array_split(np.arange(len(parameters)), min(_THREADS, len(parameters)))
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(lambda rows: self._fill(parameters, values, rows), halves))
        values += _log_prior(parameters)
        if self.selection is not None:
            values -= self.selection.log_probability(parameters)
        return values

    def _fill(self, parameters: Floats, values: Floats, rows: NDArray[np.intp]) -> None:
        log_likelihood(self.components, parameters[rows], values[rows[0] : rows[-1] + 1])

    @property
    def start(self) -> Floats:
        """Moments of the capsules, to begin from : (5,) array."""
        weights = self.components[:, :, 0]
        x, y = ((weights * self.components[:, :, k]).sum(axis=1) / weights.sum(axis=1) for k in (1, 2))
        spread = [0.5 * np.std(means) + 0.02 for means in (x, y)]
        return np.array([np.median(x), np.median(y), *np.log(spread), 0.0], dtype=np.float64)


def _log_prior(parameters: Floats) -> Floats:
    """Return the log prior: half-normal spreads, as densities of their logarithms and none below 1e-3; normal slope."""
    spreads, slope = parameters[:, 2:4], parameters[:, 4]
    values = np.sum(spreads - 0.5 * (np.exp(spreads) / SPREADS) ** 2, axis=1) - 0.5 * (slope / SLOPES) ** 2
    return np.where((spreads > _LOWEST_SPREAD).all(axis=1), values, -1e10)


@compiled
def log_likelihood(components: NDArray[np.float32], parameters: Floats, into: Floats) -> None:
    """Compute the log likelihood of all capsules for some populations.

    Parameters
    ----------
    components : (n, c, 6) array
        Of the capsules, laid out by `mixture`.
    parameters : (d, 5) array
        `PARAMETERS` of each population.
    into : (d,) array
        Filled.
    """
    for d in range(len(parameters)):
        x, y, spread, radius_spread, slope = parameters[d]
        of_radius, given = np.exp(2.0 * radius_spread), np.exp(2.0 * spread)
        pop_xx, pop_xy, pop_yy = given + slope * slope * of_radius, slope * of_radius, of_radius
        total = 0.0
        for n in range(len(components)):
            density = 0.0
            for k in range(components.shape[1]):
                weight = components[n, k, 0]
                if weight > 0.0:
                    dx, dy = components[n, k, 1] - x, components[n, k, 2] - y
                    xx, xy = components[n, k, 3] + pop_xx, components[n, k, 4] + pop_xy
                    yy = components[n, k, 5] + pop_yy
                    determinant = xx * yy - xy * xy
                    square = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
                    if square < 1400.0:
                        density += weight * np.exp(-0.5 * square) / np.sqrt(determinant)
            total += np.log(max(density, 1e-300))
        into[d] = total
