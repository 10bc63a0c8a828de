"""Log posterior density of a population of (log G_s, log a): likelihood of all capsules, priors, selection.

A capsule's own likelihood is a mixture of Gaussians, so its integral over a Gaussian population is a sum of Gaussians,

    p(capsule | population) = sum_k w_k N(m_k; mu, Sigma + S_k).

A population with the tails of t distributions is a mixture of Gaussian ones, and the sum goes over these too.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.infer.kernel import compiled
from capsbayes.infer.many.distribution.selection import Selection
from capsbayes.infer.many.distribution.tails import NODES, NORMAL, ScaleMixture, log_prior_of_freedom

PARAMETERS = ("log_modulus", "log_radius", "log_spread", "log_radius_spread", "slope")
"""Means of log G_s and log a, logarithms of the standard deviations of log G_s at given size and of log a, and the
slope d ln G_s / d ln a."""

FREEDOMS = ("log_modulus_freedom", "log_radius_freedom")
"""Of t distributions further: logarithms of the freedom of log G_s at given size and of log a, whose scales then take
the place of the standard deviations."""

SPREADS, SLOPES = 1.0, 5.0  # scales of the priors: half-normal of both spreads, normal of the slope
_LOWEST_SPREAD = np.log(1e-3)
_FREEDOM = np.log(10.0)  # to begin from
_THREADS = 2


@dataclass(frozen=True, eq=False)
class LogPosterior:
    """Log posterior density of the `PARAMETERS` of a population, and of its `FREEDOMS` if its tails are not normal.

    Parameters
    ----------
    components : (n, c, 6) array
        Likelihood of each capsule in (log G_s, log a).
    selection : Selection, optional
    tails : str
        One of `capsbayes.infer.many.distribution.tails.TAILS`.
    """

    components: NDArray[np.float32]
    selection: Selection | None = None
    tails: str = NORMAL

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return PARAMETERS if self.tails == NORMAL else (*PARAMETERS, *FREEDOMS)

    @property
    def size(self) -> int:
        """Number of Gaussians of one evaluation."""
        return self.components[..., 0].size * (1 if self.tails == NORMAL else NODES**2)

    def mixtures(self, parameters: Floats) -> tuple[ScaleMixture, ScaleMixture]:
        """Return the tails of log G_s at given size and of log a of some populations : (d, p) array."""
        if self.tails == NORMAL:
            normal = ScaleMixture.normal(len(parameters))
            return normal, normal
        first = len(PARAMETERS)
        return ScaleMixture.of_freedom(parameters[:, first]), ScaleMixture.of_freedom(parameters[:, first + 1])

    def __call__(self, parameters: Floats) -> Floats:
        """Return the log density of some populations, up to a constant : (d, p) -> (d,) array."""
        parameters = np.ascontiguousarray(np.atleast_2d(parameters))
        values = np.empty(len(parameters))
        halves = np.array_split(np.arange(len(parameters)), min(_THREADS, len(parameters)))
        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(lambda rows: self._fill(parameters, values, rows), halves))
        values += _log_prior(parameters)
        return values

    def _fill(self, parameters: Floats, values: Floats, rows: NDArray[np.intp]) -> None:
        some = parameters[rows]
        modulus, radius = self.mixtures(some)
        into = values[rows[0] : rows[-1] + 1]
        log_likelihood(self.components, some, *modulus, *radius, into)
        if self.selection is not None:
            into -= self.selection.log_probability(some, modulus, radius)

    def of_capsules(self, parameters: Floats) -> Floats:
        """Return the log likelihood of each capsule for some populations, up to a constant of the capsule.

        Parameters
        ----------
        parameters : (d, p) array

        Returns
        -------
        (d, n) array
            Given that the capsule is in the sample. Their sum over the capsules is the log likelihood.
        """
        parameters = np.ascontiguousarray(parameters)
        modulus, radius = self.mixtures(parameters)
        values = np.empty((len(self.components), len(parameters)))
        for n, into in enumerate(values):
            log_likelihood(self.components[n : n + 1], parameters, *modulus, *radius, into)
        if self.selection is None:
            return values.T
        return values.T - self.selection.log_probabilities(parameters, modulus, radius)

    @property
    def start(self) -> Floats:
        """Moments of the capsules, to begin from : (p,) array."""
        weights = self.components[:, :, 0]
        x, y = ((weights * self.components[:, :, k]).sum(axis=1) / weights.sum(axis=1) for k in (1, 2))
        spread = [0.5 * np.std(means) + 0.02 for means in (x, y)]
        freedoms = [_FREEDOM] * (len(self.names) - len(PARAMETERS))
        return np.array([np.median(x), np.median(y), *np.log(spread), 0.0, *freedoms], dtype=np.float64)


def _log_prior(parameters: Floats) -> Floats:
    """Return the log prior: half-normal spreads, as densities of their logarithms and none below 1e-3; normal slope."""
    spreads, slope = parameters[:, 2:4], parameters[:, 4]
    values = np.sum(spreads - 0.5 * (np.exp(spreads) / SPREADS) ** 2, axis=1) - 0.5 * (slope / SLOPES) ** 2
    values += np.sum(log_prior_of_freedom(parameters[:, len(PARAMETERS) :]), axis=1)
    return np.where((spreads > _LOWEST_SPREAD).all(axis=1), values, -1e10)


@compiled
def log_likelihood(
    components: NDArray[np.float32],
    parameters: Floats,
    modulus_variance: Floats,
    modulus_weight: Floats,
    radius_variance: Floats,
    radius_weight: Floats,
    into: Floats,
) -> None:
    """Compute the log likelihood of all capsules for some populations.

    Parameters
    ----------
    components : (n, c, 6) array
        Of the capsules, laid out by `mixture`.
    parameters : (d, p) array
        `PARAMETERS` of each population.
    modulus_variance, modulus_weight, radius_variance, radius_weight : (d, j) arrays
        Tails of log G_s at given size and of log a, as of `ScaleMixture`.
    into : (d,) array
        Filled.
    """
    nodes = modulus_variance.shape[1]
    for d in range(len(parameters)):
        x, y, spread, radius_spread, slope = parameters[d, :5]
        total = 0.0
        for n in range(len(components)):
            density = 0.0
            for i in range(nodes):
                given = np.exp(2.0 * spread) * modulus_variance[d, i]
                for j in range(nodes):
                    of_radius = np.exp(2.0 * radius_spread) * radius_variance[d, j]
                    pop_xx, pop_xy, pop_yy = given + slope * slope * of_radius, slope * of_radius, of_radius
                    share = modulus_weight[d, i] * radius_weight[d, j]
                    for k in range(components.shape[1]):
                        weight = components[n, k, 0]
                        if weight > 0.0:
                            dx, dy = components[n, k, 1] - x, components[n, k, 2] - y
                            xx, xy = components[n, k, 3] + pop_xx, components[n, k, 4] + pop_xy
                            yy = components[n, k, 5] + pop_yy
                            determinant = xx * yy - xy * xy
                            square = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
                            if square < 1400.0:
                                density += share * weight * np.exp(-0.5 * square) / np.sqrt(determinant)
            total += np.log(max(density, 1e-300))
        into[d] = total
