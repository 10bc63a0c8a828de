"""Places of edges and of dark lines in profiles of intensity, by least squares on many profiles at once.

Both models have two parameters that matter, place and width, and several that do not and enter linearly. The latter
are eliminated in each step (variable projection with the Jacobian of Kaufman), so that what is left is a Gauss-Newton
iteration in two unknowns.

References
----------
Kaufman 1975, BIT 15, 49 (doi 10.1007/BF01932995).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

__all__ = ["Located", "band", "edge", "line", "locate"]

Floats = NDArray[np.float64]
Model = Callable[[Floats, Floats], Floats]

_ITERATIONS = 12
_TOLERANCE = 2e-3  # px
_WIDTHS = (0.3, 12.0)  # px
_STEP = 1e-4  # of the differences that stand for derivatives


@dataclass(frozen=True, eq=False)
class Located:
    """Where an edge or a line lies in each of n profiles.

    Parameters
    ----------
    place, width : (n,) array
        In the unit of the samples' positions.
    place_variance : (n,) array
        Variance of the place where each sample has noise of variance 1.
    coefficients : (n, k) array
        Of the model's k functions.
    fitted : (n, m) array
        The model at the samples.
    slope : (n, m) array
        Its derivative with respect to the place.
    converged : (n,) array of bool
    """

    place: Floats
    width: Floats
    place_variance: Floats
    coefficients: Floats
    fitted: Floats
    slope: Floats
    converged: NDArray[np.bool_]


def edge(t: Floats, width: Floats) -> Floats:
    """A jump between two straight lines, blurred by a Gaussian : (n, m, 4) array of functions, the jump third.

    Outside lie the background and its halo, inside the dark band: whatever they are, near the edge they are smooth.
    """
    u = t / width
    above = ndtr(u)
    ramp = width * (u * above + np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi))
    return np.stack([np.ones_like(t), t - ramp, above, ramp], axis=-1)


def line(t: Floats, width: Floats) -> Floats:
    """A Gaussian between two levels : (n, m, 3) array of functions, the Gaussian first; width is its deviation."""
    u = t / width
    return np.stack([np.exp(-0.5 * u**2), np.ones_like(t), ndtr(u)], axis=-1)


def band(t: Floats, width: Floats) -> Floats:
    """A Gaussian on a parabola : (n, m, 4) array of functions, the Gaussian first; width is its deviation."""
    return np.stack([np.exp(-0.5 * (t / width) ** 2), np.ones_like(t), t, t**2], axis=-1)


def locate(profiles: Floats, samples: Floats, model: Model, place: Floats, width: Floats, used: Floats) -> Located:
    """Fit a model to each profile.

    Parameters
    ----------
    profiles : (n, m) array
        Intensities.
    samples : (m,) array
        Their positions.
    model : function
        `edge`, `line` or `band`: of the positions from the place (n, m) and the width (n, 1), to (n, m, k).
    place, width : (n,) array
        Where to start.
    used : (n, m) array
        1 for the samples to fit, 0 for the others.

    Returns
    -------
    Located
    """
    place, width = place.copy(), width.copy()
    moving = np.ones(len(place), dtype=np.bool_)
    for _ in range(_ITERATIONS):
        now = moving.nonzero()[0]
        parts = _linearised(profiles[now], samples, model, place[now], width[now], used[now])
        step = _solved(parts[3], parts[2])
        step = np.clip(step, [-1.0, -0.4], [1.0, 0.4])
        place[now] += step[:, 0]
        width[now] = np.clip(width[now] * np.exp(step[:, 1]), *_WIDTHS)
        moving[now] = np.abs(step[:, 0]) > _TOLERANCE
        if not moving.any():
            break
    coefficients, fitted, _, jacobian, slope = _linearised(profiles, samples, model, place, width, used)
    information = np.einsum("nmi,nmj->nij", jacobian, jacobian) + 1e-12 * np.eye(2)
    variance = np.linalg.inv(information)[:, 0, 0]
    return Located(place, width, variance, coefficients, fitted, slope, ~moving)


def _linearised(
    profiles: Floats, samples: Floats, model: Model, place: Floats, width: Floats, used: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Coefficients, fit, residual, Jacobian by place and log width with the coefficients eliminated, raw slope."""
    t, w = samples - place[:, None], width[:, None]
    functions = model(t, w)
    q, r = np.linalg.qr(functions * used[..., None])
    data = profiles * used
    inner = np.einsum("nmk,nm->nk", q, data)
    ridge = 1e-10 * np.eye(r.shape[-1])  # two functions may become alike as the width grows
    coefficients = np.linalg.solve(
        np.einsum("nki,nkj->nij", r, r) + ridge, np.einsum("nkj,nk->nj", r, inner)[..., None]
    )
    weights = coefficients[:, None, :, 0]
    fitted = np.sum(functions * weights, axis=-1)
    by_place = np.sum((model(t - _STEP, w) - functions) * weights, axis=-1) / _STEP
    by_width = np.sum((model(t, w * (1.0 + _STEP)) - functions) * weights, axis=-1) / _STEP
    jacobian = np.stack([by_place, by_width], axis=-1) * used[..., None]
    jacobian -= q @ (np.swapaxes(q, 1, 2) @ jacobian)
    return coefficients[..., 0], fitted, data - fitted * used, jacobian, by_place


def _solved(jacobian: Floats, residual: Floats) -> Floats:
    normal = np.einsum("nmi,nmj->nij", jacobian, jacobian)
    normal = normal * (1.0 + 1e-6 * np.eye(2)) + 1e-12 * np.eye(2)
    return np.linalg.solve(normal, np.einsum("nmi,nm->ni", jacobian, residual)[..., None])[..., 0]
