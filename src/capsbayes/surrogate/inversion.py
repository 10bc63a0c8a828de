"""Inversion of a map of the plane: the points at which a forward map gives wanted values, for a batch at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.least_squares import Linearised, minimise

Forward = Callable[[Floats, Integers], tuple[Floats, Floats]]

_UNIT = 1e-5  # of the values, which count as standard error
_EXACT = 1e-10
_LONGEST, _STEPS = 2.0, 60


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
    """Invert a map of the plane for a batch; where no point gives the values exactly, find the nearest.

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

    def evaluate(points: Floats, rows: Integers) -> Linearised:
        values, gradients = forward(points, rows)
        return Linearised(points, (values - wanted[rows]) / _UNIT, gradients / _UNIT)

    nowhere = np.full(wanted.shape, np.nan)
    found = Linearised(nowhere, nowhere.copy(), np.full((*wanted.shape, 2), np.nan))
    misfit = np.full(len(wanted), np.inf)
    for start in np.asarray(starts, dtype=np.float64):
        rows = np.flatnonzero(misfit >= _EXACT)
        if not len(rows):
            break
        found.take_better(rows, minimise(evaluate, evaluate(start[rows], rows), rows, _LONGEST, _STEPS))
        misfit = np.nan_to_num(_UNIT * np.abs(found.residuals).max(axis=1), nan=np.inf)
    return Inversion(found.points, misfit, misfit < _EXACT)
