"""Compiled: the likelihood of a Gaussian population of (log G_s, log a), the errors of each capsule integrated out.

A capsule's own likelihood is a mixture of Gaussians, so its integral over a Gaussian population is a sum of Gaussians,

    p(capsule | population) = sum_k w_k N(m_k; mu, Sigma + S_k).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["PARAMETERS", "log_likelihood"]

Floats = NDArray[np.float64]

PARAMETERS = ("log_modulus", "log_radius", "log_spread", "log_radius_spread", "slope")
"""Means of log G_s and log a, logarithms of the standard deviations of log G_s at given size and of log a, and the
slope d ln G_s / d ln a."""

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def log_likelihood(components: NDArray[np.float32], parameters: Floats, into: Floats) -> None:
    """Log likelihood of all capsules for some populations.

    Parameters
    ----------
    components : (n, c, 6) array
        Of the capsules, as `capsbayes.infer.many.tabulated.mixture` lays them out.
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
