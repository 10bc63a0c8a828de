"""Inverse of the forward map: the point of the plane at which an approximation gives wanted values.

Levenberg-Marquardt with the approximation's exact gradient, from several
starts; where no point gives the values exactly, the nearest in least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Solution", "solve"]

Floats = NDArray[np.float64]
Forward = Callable[[Floats], tuple[Floats, Floats]]

TOLERANCE = 1e-10
ITERATIONS = 60
LONGEST_STEP = 2.0


@dataclass(frozen=True, eq=False)
class Solution:
    """Point (2,), the misfit there (largest absolute difference), and whether it is an exact solution."""

    point: Floats
    misfit: float
    exact: bool


def solve(forward: Forward, wanted: Floats, starts: Floats) -> Solution:
    """Invert a map of the plane.

    Parameters
    ----------
    forward : callable
        Maps a point (2,) to its values (2,) and their gradient (2, 2), NaN where the map is not defined.
    wanted : (2,) array
        The values to reach.
    starts : (s, 2) array
        First guesses, the best first; the first that leads to an exact solution is the last one used.

    Examples
    --------
    >>> def forward(x):
    ...     return np.array([x[0] ** 2, x[0] + x[1]]), np.array([[2 * x[0], 0.0], [1.0, 1.0]])
    >>> solve(forward, np.array([4.0, 5.0]), np.array([[1.0, 1.0]])).point.round(9)
    array([2., 3.])
    """
    best = Solution(np.full(2, np.nan), np.inf, False)
    for start in starts:
        found = _descend(forward, wanted, np.asarray(start, dtype=np.float64))
        if found.misfit < best.misfit:
            best = found
        if best.exact:
            break
    return best


def _descend(forward: Forward, wanted: Floats, point: Floats) -> Solution:
    value, gradient = forward(point)
    miss, damping = value - wanted, 1e-3
    for _ in range(ITERATIONS):
        if not np.all(np.isfinite(miss)) or np.abs(miss).max() < TOLERANCE:
            break
        normal = gradient.T @ gradient
        curbed = normal + damping * np.diag(np.maximum(np.diag(normal), 1e-12))
        step = -np.linalg.solve(curbed, gradient.T @ miss)
        step *= min(1.0, LONGEST_STEP / max(np.abs(step).max(), 1e-300))
        value, trial = forward(point + step)
        if np.all(np.isfinite(value)) and np.sum((value - wanted) ** 2) < np.sum(miss**2):
            point, gradient, miss, damping = point + step, trial, value - wanted, damping / 5
        elif np.abs(step).max() < 1e-13:
            break
        else:
            damping = max(4 * damping, 1e-12)
    misfit = float(np.abs(miss).max()) if np.all(np.isfinite(miss)) else np.inf
    return Solution(point, misfit, misfit < TOLERANCE)
