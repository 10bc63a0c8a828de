"""Features of a squared-exponential Gaussian process over a few coordinates, about a lattice of inducing points."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats

_POINTS = 3  # of the lattice along each coordinate
_JITTER = 1e-8


def smooth_features(places: Floats, lengths: Floats) -> Floats:
    """Return features (n, 3^d) of places (n, d) whose products are the covariances of a process of variance one."""
    # The covariance is projected onto a lattice over the range of the places (Quiñonero-Candela & Rasmussen 2005, J.
    # Mach. Learn. Res. 6, 1939), good where this range is no more than a few length scales (d,).
    low, high = places.min(axis=0) / lengths, places.max(axis=0) / lengths
    axes = [np.linspace(*ends, _POINTS) for ends in zip(low, high, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(lengths))
    within = _kernel(lattice, lattice) + _JITTER * np.eye(len(lattice))
    factor = np.linalg.cholesky(within)
    return np.asarray(scipy.linalg.solve_triangular(factor, _kernel(lattice, places / lengths), lower=True).T)


def _kernel(first: Floats, second: Floats) -> Floats:
    return np.asarray(np.exp(-0.5 * np.sum((first[:, None] - second) ** 2, axis=-1)))
