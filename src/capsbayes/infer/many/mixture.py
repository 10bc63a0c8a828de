"""Likelihood of (log G_s, log a) of one capsule as a mixture of Gaussians; compiled.

The nodes of a posterior are shared linearly among overlapping slices along their longest axis; each slice is a
component with its own mean and covariance. The mixture keeps the bend of a ridge, on which L_z alone was measured, and
its total moments are those of the nodes. A Gaussian population then meets it in closed form.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from capsbayes.arrays import Floats

COMPONENTS = 12
NUMBERS = ("weight", "x", "y", "xx", "xy", "yy")
"""Of each component: its probability, means and covariances of two logarithms."""

_REACH = 4.0  # standard deviations on either side that the slices divide


@njit(cache=True, nogil=True, error_model="numpy")
def mixture(weights: Floats, x: Floats, y: Floats, into: Floats) -> None:
    """Represent weighted points by components.

    Parameters
    ----------
    weights : (n,) array
        Positive, of any sum.
    x, y : (n,) arrays
    into : (COMPONENTS, 6) array
        Filled with `NUMBERS`; components without points have weight zero.
    """
    total = weights.sum()
    mx, my = np.sum(weights * x) / total, np.sum(weights * y) / total
    dx, dy = x - mx, y - my
    xx, xy, yy = (np.sum(weights * dx * dx), np.sum(weights * dx * dy), np.sum(weights * dy * dy))
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    along = np.cos(angle) * dx + np.sin(angle) * dy
    spread = np.sqrt(np.sum(weights * along * along) / total)
    low, high = max(along.min(), -_REACH * spread), min(along.max(), _REACH * spread)
    slices = len(into)
    width = (high - low) / (slices - 1)
    into[:] = 0.0
    for k in range(len(weights)):
        place = (along[k] - low) / width if width > 0.0 else 0.0
        place = min(max(place, 0.0), slices - 1.000001)
        left = int(place)
        for slot, share in ((left, 1.0 - (place - left)), (left + 1, place - left)):
            part = share * weights[k] / total
            into[slot, 0] += part
            into[slot, 1] += part * dx[k]
            into[slot, 2] += part * dy[k]
            into[slot, 3] += part * dx[k] * dx[k]
            into[slot, 4] += part * dx[k] * dy[k]
            into[slot, 5] += part * dy[k] * dy[k]
    for component in into:
        if component[0] > 0.0:
            component[1:] /= component[0]
            component[3] -= component[1] * component[1]
            component[4] -= component[1] * component[2]
            component[5] -= component[2] * component[2]
            component[1] += mx
            component[2] += my


def merged(components: NDArray[np.float32], neighbours: int) -> NDArray[np.float32]:
    """Merge neighbouring components, whose weight, mean and covariance stay : (n, c, 6) -> (n, c / k, 6) array."""
    parts = components.reshape(len(components), -1, neighbours, len(NUMBERS)).astype(np.float64)
    weight = parts[..., 0].sum(axis=2)
    shares = parts[..., 0] / np.where(weight > 0.0, weight, 1.0)[..., None]
    x, y, xx, xy, yy = (np.sum(shares * parts[..., k], axis=2) for k in range(1, len(NUMBERS)))
    dx, dy = parts[..., 1] - x[..., None], parts[..., 2] - y[..., None]
    between = (np.sum(shares * product, axis=2) for product in (dx * dx, dx * dy, dy * dy))
    seconds = [within + extra for within, extra in zip((xx, xy, yy), between, strict=True)]
    return np.stack([weight, x, y, *seconds], axis=2).astype(np.float32)
