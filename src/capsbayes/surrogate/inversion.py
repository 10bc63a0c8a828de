"""Inversion of a map of the plane: the points at which a forward map gives wanted values, for a batch at once.

Levenberg-Marquardt with the map's own gradient, from several starting points
each; where no point gives the values exactly, the nearest in least squares.

References
----------
Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
J. Soc. Ind. Appl. Math. 11, 431 (1963), doi:10.1137/0111030.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats, Integers

Forward = Callable[[Floats, Integers], tuple[Floats, Floats]]

TOLERANCE = 1e-10
ITERATIONS = 60
LONGEST_STEP = 2.0


@dataclass(frozen=True, eq=False)
class Inversion:
    """Solutions of n problems.

    Parameters
    ----------
    points : (n, 2) array
        NaN where no starting point lies within the map.
    misfit : (n,) array
        Largest absolute difference from the wanted values; infinite where there is no point.
    exact : (n,) bool array
        Whether the values are reached to roundoff.
    """

    points: Floats
    misfit: Floats
    exact: Booleans


def solve(forward: Forward, wanted: Floats, starts: Floats) -> Inversion:
    """Invert a map of the plane for a batch.

    Parameters
    ----------
    forward : callable
        Maps points (k, 2), and the rows (k,) of the problems that they belong to, to values (k, 2) and their gradients
        (k, 2, 2), NaN where the map is not defined.
    wanted : (n, 2) array
        The values to reach.
    starts : (s, n, 2) array
        Starting points, the best first; the next one is tried where the last did not lead to an exact solution.

    Returns
    -------
    Inversion

    Examples
    --------
    >>> def forward(x, rows):
    ...     slope = np.stack([np.stack([2 * x[:, 0], 0 * x[:, 0]], 1), np.ones_like(x)], 1)
    ...     return np.stack([x[:, 0] ** 2, x[:, 0] + x[:, 1]], 1), slope
    >>> solve(forward, np.array([[4.0, 5.0], [9.0, 1.0]]), np.ones((1, 2, 2))).points.round(9).tolist()
    [[2.0, 3.0], [3.0, -2.0]]
    """
    points, misfit = np.full(wanted.shape, np.nan), np.full(len(wanted), np.inf)
    for start in np.asarray(starts, dtype=np.float64):
        rows = np.flatnonzero(misfit >= TOLERANCE)
        reached, left = _descend(forward, wanted[rows], start[rows], rows)
        better = left < misfit[rows]
        points[rows[better]], misfit[rows[better]] = reached[better], left[better]
    return Inversion(points, misfit, misfit < TOLERANCE)


def _descend(forward: Forward, wanted: Floats, start: Floats, rows: Integers) -> tuple[Floats, Floats]:
    """Return where k problems end (k, 2), from one starting point each, and their misfits there (k,)."""
    point = start.copy()
    value, gradient = forward(point, rows)
    miss, damping = value - wanted, np.full(len(rows), 1e-3)
    moving = np.isfinite(miss).all(axis=1)
    for _ in range(ITERATIONS):
        moving &= ~(np.abs(miss).max(axis=1) < TOLERANCE)
        here = np.flatnonzero(moving)
        if not here.size:
            break
        slopes = gradient[here]
        normal = np.swapaxes(slopes, 1, 2) @ slopes
        diagonal = np.maximum(np.einsum("kii->ki", normal), 1e-12)
        curbed = normal + damping[here, None, None] * diagonal[:, :, None] * np.eye(2)
        pull = np.swapaxes(slopes, 1, 2) @ miss[here][..., None]
        step = -np.linalg.solve(curbed, pull)[..., 0]
        longest = np.abs(step).max(axis=1)
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-300))[:, None]
        value, trial = forward(point[here] + step, rows[here])
        with np.errstate(invalid="ignore"):
            better = np.sum((value - wanted[here]) ** 2, axis=1) < np.sum(miss[here] ** 2, axis=1)
        taken, kept = here[better], here[~better]
        point[taken] += step[better]
        gradient[taken], miss[taken] = trial[better], (value - wanted[here])[better]
        damping[taken] /= 5.0
        damping[kept] = np.maximum(4.0 * damping[kept], 1e-12)
        moving[kept] = np.abs(step[~better]).max(axis=1, initial=0.0) >= 1e-13
    with np.errstate(invalid="ignore"):
        left = np.abs(miss).max(axis=1)
    return point, np.where(np.isfinite(left), left, np.inf)
