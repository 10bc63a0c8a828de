"""The furthest point of an outline in one direction, with its error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.image.edges.outline import EdgeOutline
from capsbayes.image.edges.robust import wider_by_few

_WINDOWS = (15, 10, 7, 5)  # points to either side, widest first
_ORDER = 4
_MISFIT = 1.6  # of the residual's mean square over its expectation: largest that a window may have
EDGE_FLOOR = 0.03  # px: no edge is located better than that in a picture sampled at whole pixels


@dataclass(frozen=True)
class FurthestPoint:
    """Furthest point of an outline in a direction.

    Parameters
    ----------
    distance, variance : float [px, px^2]
        Along the direction from the origin of the picture, and the variance of its error.
    systematic : float [px^2]
        The part of the variance that is the same in all pictures of a capsule.
    """

    distance: float
    variance: float
    systematic: float


def furthest_point(outline: EdgeOutline, direction: Floats, misfit: float, shift: float = 0.0) -> FurthestPoint:
    """Return the largest distance of an outline along a direction.

    The largest of many uncertain points would lie too far out; the maximum of a quartic through its neighbours does
    not. The widest neighbourhood is used in which the quartic agrees with the points to within their errors. The
    direction is a unit vector (2,), the misfit [1/px] the error of the edge's model over the square of the edge's
    width: the first term that the model lacks is quadratic. The shift [px] is the standard error of all edges together.
    """
    reach = outline.points @ direction
    trusted = np.hypot(outline.point_error, np.hypot(misfit * outline.edge_width**2, EDGE_FLOOR))
    top = int(np.argmax(_moving_mean(reach)))
    for window in _WINDOWS:
        index = np.arange(top - window, top + window + 1) % len(reach)
        t, design = _design(window)
        error = trusted[index]
        weighted = design / error[:, None]
        inverse = np.linalg.solve(weighted.T @ weighted, weighted.T) / error
        coefficients = inverse @ reach[index]
        residual = (reach[index] - design @ coefficients) / error
        if residual @ residual < _MISFIT * (len(t) - _ORDER - 1):
            break
    powers = np.arange(_ORDER + 1)
    fine = np.linspace(-0.5, 0.5, 101)
    values = (fine[:, None] ** powers) @ coefficients
    best = int(np.argmax(values))
    free = len(t) - _ORDER - 1
    excess = max(1.0, wider_by_few(free) ** 2 * float(residual @ residual) / free)
    value, slope, bend = _derivatives(fine[best], powers)
    weights = value @ inverse
    of_arcs = np.bincount(outline.arc[index], weights * outline.arc_error[index])
    variance = excess * float(np.sum((weights * error) ** 2)) + float(np.sum(of_arcs**2))
    too_far = _too_far(excess * float(np.sum((slope @ inverse * error) ** 2)), -float(bend @ coefficients), variance)
    model = (misfit * float(outline.edge_width[top]) ** 2) ** 2 + EDGE_FLOOR**2 + shift**2
    return FurthestPoint(float(values[best]) - too_far, variance + model, model)


@lru_cache
def _design(window: int) -> tuple[Floats, Floats]:
    """Return the places of the points of a window, over its half, and their powers."""
    t = np.arange(-window, window + 1) / window
    return t, t[:, None] ** np.arange(_ORDER + 1)


def _derivatives(t: float, powers: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
    """Return the powers of t with their first and second derivatives."""
    once, twice = np.maximum(powers - 1, 0), np.maximum(powers - 2, 0)
    return np.asarray(t**powers), np.asarray(powers * t**once), np.asarray(powers * once * t**twice)


def _too_far(slope_variance: float, bend: float, variance: float) -> float:
    """Return how much too large the maximum of a fitted curve is on average, as it lies where errors raise the curve.

    An error of the slope moves the maximum of a curve whose second derivative is -bend, and raises it by half the
    slope's square over the bend. No more than the standard error of the maximum is taken off a flat curve.
    """
    largest = float(np.sqrt(variance))
    return min(0.5 * slope_variance / bend, largest) if bend > 0.0 else largest


def _moving_mean(values: Floats) -> Floats:
    return np.convolve(np.concatenate([values[-2:], values, values[:2]]), np.full(5, 0.2), mode="valid")
