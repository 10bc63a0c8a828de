"""Log posterior density of a population: the likelihood of all capsules, priors, and what was kept of them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.infer.many.hyper_likelihood import log_likelihood
from capsbayes.infer.many.selection import Selection

__all__ = ["SLOPES", "LogPosterior"]

Floats = NDArray[np.float64]

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
        """Log density of some populations, up to a constant : (d, 5) -> (d,) array."""
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
        spread = [0.5 * np.std(one) + 0.02 for one in (x, y)]
        return np.array([np.median(x), np.median(y), *np.log(spread), 0.0], dtype=np.float64)


def _log_prior(parameters: Floats) -> Floats:
    """Half-normal spreads, as densities of their logarithms, and a normal slope; nothing below a thousandth."""
    spreads, slope = parameters[:, 2:4], parameters[:, 4]
    values = np.sum(spreads - 0.5 * (np.exp(spreads) / SPREADS) ** 2, axis=1) - 0.5 * (slope / SLOPES) ** 2
    return np.where((spreads > _LOWEST_SPREAD).all(axis=1), values, -1e10)
