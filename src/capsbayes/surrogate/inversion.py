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
    """Solutions of n problems."""

    points: Floats  # (n, 2): NaN where no starting point lies within the map
    misfit: Floats  # (n,): largest absolute difference from the wanted values; infinite without a point
    exact: Booleans  # (n,): whether the values are reached to roundoff


def solve(forward: Forward, wanted: Floats, starts: Floats) -> Inversion:
    """Invert a map of the plane for a batch; where no point gives the values (n, 2) exactly, find the nearest.

    >>> def forward(x, rows):
    ...     slope = np.stack([np.stack([2 * x[:, 0], 0 * x[:, 0]], 1), np.ones_like(x)], 1)
    ...     return np.stack([x[:, 0] ** 2, x[:, 0] + x[:, 1]], 1), slope
    >>> solve(forward, np.array([[4.0, 5.0], [9.0, 1.0]]), np.ones((1, 2, 2))).points.round(9).tolist()
    [[2.0, 3.0], [3.0, -2.0]]
    """
    # `forward` maps points (k, 2) and the rows (k,) of their problems to values (k, 2) and gradients (k, 2, 2), NaN
    # where it is not defined. Of `starts` (s, n, 2), the best first, the next is tried where the last led to no exact
    # solution.

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
