"""Posterior predictive check of the tails of a population.

The residuals of the capsules from the population, over their standard errors, are compared with those of replicates:
capsules drawn from the population, in the same flows, under the same selection and with the same errors. The
discrepancy is the kurtosis, which heavy tails and odd capsules raise and two groups lower: A. Gelman, X.-L. Meng and
H. Stern, Statistica Sinica 6 (1996) 733.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.many.distribution.log_posterior import LogPosterior

_DRAWS, _MOST = 500, 2000  # of the posterior; of the capsules
_ROUNDS = 60  # of replicates drawn again because they would not be in the sample

RESIDUALS = ("surface_shear_modulus", "capsule_radius")
"""Residuals that are checked: of log G_s at given size, and of log a."""


def tail_p_values(log_posterior: LogPosterior, parameters: Floats, rng: np.random.Generator) -> dict[str, float]:
    """Return the share of replicates whose kurtosis is at least that of the capsules, for each of the `RESIDUALS`.

    Parameters
    ----------
    log_posterior : LogPosterior
    parameters : (d, p) array
        Draws of it.
    rng : numpy.random.Generator
    """
    components, selection = log_posterior.components.astype(np.float64), log_posterior.selection
    chosen = np.sort(rng.choice(len(components), min(len(components), _MOST), replace=False))
    components = components[chosen]
    if selection is not None:
        selection = replace(selection, flow=selection.flow[chosen], half_width=selection.half_width[chosen])
    places, own = _moments(components)
    parameters = parameters[rng.choice(len(parameters), _DRAWS)]
    modulus, radius = log_posterior.mixtures(parameters)
    x, y, log_spread, log_radius_spread, slope = parameters[:, :5].T
    drawn = np.zeros((_DRAWS, len(chosen), 2))
    d, n = (index.ravel() for index in np.indices(drawn.shape[:2]))
    for _ in range(_ROUNDS):
        larger = np.exp(log_radius_spread[d]) * radius.drawn(rng, d) * rng.standard_normal(len(d))
        harder = np.exp(log_spread[d]) * modulus.drawn(rng, d) * rng.standard_normal(len(d)) + slope[d] * larger
        drawn[d, n] = np.stack([x[d] + harder, y[d] + larger], axis=1)
        if selection is None:
            break
        again = ~selection.holds(drawn[d, n, 0], drawn[d, n, 1], n, rng)
        d, n = d[again], n[again]
    first, second = rng.standard_normal((2, *drawn.shape[:2]))
    along = np.sqrt(own[:, 0, 0])
    across = own[:, 0, 1] / along
    noise = np.stack([along * first, across * first + np.sqrt(own[:, 1, 1] - across**2) * second], axis=-1)
    sizes = [_kurtoses(values, own, parameters) for values in (places[None], drawn + noise)]
    exceeding = np.sum(sizes[1] >= sizes[0], axis=1)
    return {name: (1.0 + float(count)) / (1.0 + _DRAWS) for name, count in zip(RESIDUALS, exceeding, strict=True)}


def _moments(components: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of the likelihood of each capsule : (n, 2), (n, 2, 2) arrays."""
    weights = components[..., 0] / components[..., 0].sum(axis=1, keepdims=True)
    means = np.sum(weights[..., None] * components[..., 1:3], axis=1)
    away = components[..., 1:3] - means[:, None]
    within = components[..., [3, 4, 4, 5]].reshape(*weights.shape, 2, 2)
    return means, np.sum(weights[..., None, None] * (within + away[..., :, None] * away[..., None, :]), axis=1)


def _kurtoses(values: Floats, own: Floats, parameters: Floats) -> Floats:
    """Return the kurtosis of both residuals over their standard errors : (2, d) array."""
    x, y, slope = (parameters[:, k, None] for k in (0, 1, 4))
    sd_x, sd_y = np.exp(parameters[:, 2, None]), np.exp(parameters[:, 3, None])
    of_radius = values[..., 1] - y
    of_modulus = values[..., 0] - x - slope * of_radius
    error = own[:, 0, 0] - 2.0 * slope * own[:, 0, 1] + slope**2 * own[:, 1, 1]
    found = []
    for residual, variance in ((of_modulus, sd_x**2 + error), (of_radius, sd_y**2 + own[:, 1, 1])):
        scaled = residual / np.sqrt(variance)
        scaled = scaled - scaled.mean(axis=1, keepdims=True)
        found.append(np.mean(scaled**4, axis=1) / np.mean(scaled**2, axis=1) ** 2)
    return np.stack(found)
