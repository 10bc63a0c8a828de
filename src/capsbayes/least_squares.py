"""Nonlinear least squares for a batch of problems at once, by damped Gauss-Newton steps.

What the bend of the residuals adds to the normal matrices is learnt from step to step: where residuals are large and
bend, as those of a wrong model, Gauss-Newton steps alone go to and fro across the minimum.

Residuals are in standard errors, so that a sum of squares that may still decrease by one is a point one standard error
away from the best. The steps end where the decrease that they predict is below `TOLERANCE`, a millionth of a
standard error: far above rounding, and far below what is reported. Close to the minimum a step is judged by the
predicted decrease that remains, because differences of sums of squares are lost in rounding there.

References
----------
Dennis, Gay, Welsch, "An adaptive nonlinear least-squares algorithm", ACM Trans. Math. Softw. 7, 348 (1981),
doi:10.1145/355958.355965.
Marquardt, "An algorithm for least-squares estimation of nonlinear parameters",
J. Soc. Ind. Appl. Math. 11, 431 (1963), doi:10.1137/0111030.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Self, TypeVar

import numpy as np
from numba import njit

from capsbayes.arrays import Booleans, Floats, Integers

TOLERANCE = 1e-12
"""Predicted decrease of a sum of squares at which it counts as the least."""

_FIRST_DAMPING, _MOST_DAMPING = 1e-3, 1e8  # of the diagonal; the first also after a step that is not taken, at least
_FULFILLED = 0.1  # of the predicted decrease, in a step that is taken
_RISE = 1e-4  # of the sum, in a step that halves what is still to be gained: slopes by differences are a little off
_BETTER = 1e-3  # in the sum, by which a point is better than another
_FIRMEST = 0.8  # of a normal matrix, that the bend of residuals may take off
_RIDGE = 1e-14  # of the diagonal, where a direction has no slope of its own


@dataclass(eq=False)
class Linearised:
    """Residuals of n problems at one point each, and their slopes."""

    points: Floats  # (n, p)
    residuals: Floats  # (n, m) in standard errors, zero where a problem has fewer, NaN where it is not defined
    slopes: Floats  # (n, m, p)

    def taken(self, rows: Integers) -> Self:
        """Return some of the problems."""
        return replace(self, **{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def put(self, rows: Integers, others: Self) -> None:
        """Replace some of the problems."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(others, field.name)

    def take_better(self, rows: Integers, others: Self) -> None:
        """Replace those of some rows that are better elsewhere by more than the error of convergence."""
        better = np.flatnonzero(others.square < self.square[rows] - _BETTER)
        self.put(rows[better], others.taken(better))

    @property
    def inside(self) -> Booleans:
        """Problems that are defined there : (n,) array."""
        return np.asarray(np.isfinite(self.residuals).all(axis=1))

    @property
    def differentiable(self) -> Booleans:
        """Problems with finite slopes : (n,) array."""
        return np.asarray(np.isfinite(self.slopes).all(axis=(1, 2)))

    @property
    def square(self) -> Floats:
        """Sums of squares : (n,) array, infinite where a problem is not defined."""
        found = np.sum(self.residuals**2, axis=1)
        return np.where(np.isfinite(found), found, np.inf)

    @property
    def normal(self) -> Floats:
        """Normal matrices, the inverse covariances of the points : (n, p, p) array."""
        return np.asarray(np.einsum("nmi,nmj->nij", self.slopes, self.slopes))

    @property
    def pull(self) -> Floats:
        """Halves of the slopes of the sums of squares : (n, p) array."""
        return np.asarray(np.einsum("nmi,nm->ni", self.slopes, self.residuals))

    @property
    def left(self) -> Floats:
        """Decrease of the sums of squares that the undamped step predicts : (n,) array, infinite without slopes."""
        return self.step(np.zeros(len(self.points)))[1]

    def step(
        self, damping: Floats, longest: Floats | float = np.inf, bend: Floats | float = 0.0
    ) -> tuple[Floats, Floats]:
        """Return damped steps (n, p), each component at most `longest`, and the decrease that they predict (n,).

        `bend` (n, p, p) is what the bend of the residuals adds to the normal matrices.
        """
        pull, bent = self.pull, self.normal + bend
        diagonal = np.einsum("nii->ni", self.normal)
        damped = bent.copy()
        np.einsum("nii->ni", damped)[:] += (damping[:, None] + _RIDGE) * diagonal + np.finfo(np.float64).tiny
        step = np.clip(-np.linalg.solve(damped, pull[..., None])[..., 0], -longest, longest)
        decrease = -2.0 * np.sum(step * pull, axis=1) - np.einsum("ni,nij,nj->n", step, bent, step)
        return step, np.where(np.isfinite(decrease), decrease, np.inf)

    def bend(self, before: Self, bend: Floats) -> Floats:
        """Return the bend of the residuals (n, p, p) as a step from where they were shows it, given that there."""
        # The update is that of Dennis, Gay and Welsch; where it would leave a normal matrix that is not positive, there
        # is none.
        step = self.points - before.points
        change = np.einsum("nmi,nm->ni", self.slopes - before.slopes, self.residuals)
        slope = self.pull - before.pull
        along = np.sum(slope * step, axis=1)
        known = np.einsum("nij,nj->ni", bend, step)
        with np.errstate(divide="ignore", invalid="ignore"):
            sized = np.minimum(np.abs(np.sum(step * change, axis=1) / np.sum(step * known, axis=1)), 1.0)
            sized = np.where(np.isfinite(sized), sized, 1.0)[:, None]
            rest, slope = change - sized * known, slope / along[:, None]
            both = np.einsum("ni,nj->nij", rest, slope)
            twice = np.sum(rest * step, axis=1)[:, None, None] * np.einsum("ni,nj->nij", slope, slope)
            found = sized[..., None] * bend + both + np.swapaxes(both, 1, 2) - twice
        good = np.isfinite(found).all(axis=(1, 2)) & (along > 0.0)
        good[good] = np.linalg.eigvalsh(found[good] + (1.0 - _FIRMEST) * self.normal[good])[:, 0] > 0.0
        return np.where(good[:, None, None], found, 0.0)


Problems = TypeVar("Problems", bound=Linearised)


def minimise(
    evaluate: Callable[[Floats, Integers], Problems],
    here: Problems,
    rows: Integers,
    longest: Floats | float,
    steps: int = 30,
) -> Problems:
    """Minimise the sums of squares of k problems from `here` on, which is changed in place, and return it."""
    # `evaluate` maps points (k, p) and the rows (k,) of the problems that they belong to, to a `Linearised` of these; a
    # coordinate changes by `longest` in a step, at most. A start at which a problem is not defined stays.
    square, left = here.square, here.left
    damping, rejected = np.full(len(rows), _FIRST_DAMPING), np.zeros(len(rows), dtype=np.int64)
    bend = np.zeros_like(here.normal)
    for _ in range(steps):
        moving = np.flatnonzero(np.isfinite(square + left) & (left > TOLERANCE) & (damping < _MOST_DAMPING))
        if not len(moving):
            break
        before = here.taken(moving)
        step, predicted = before.step(damping[moving], longest, bend[moving])
        there = evaluate(here.points[moving] + step, rows[moving])
        bent = there.bend(before, bend[moving])
        ahead, gained = there.step(np.zeros(len(moving)), bend=bent)[1], square[moving] - there.square
        better = (gained > _FULFILLED * predicted) | (ahead < 0.5 * left[moving]) & (gained > -_RISE)
        taken, kept = moving[better], moving[~better]
        here.put(taken, there.taken(np.flatnonzero(better)))
        square[taken], left[taken], bend[taken] = here.square[taken], ahead[better], bent[better]
        damping[taken] *= 0.1
        rejected[taken], rejected[kept] = 0, rejected[kept] + 1
        damping[kept] = np.maximum(10.0 ** rejected[kept] * damping[kept], _FIRST_DAMPING)
        damping[moving[~there.inside & (predicted < _BETTER)]] = _MOST_DAMPING  # at the border of what is defined
    return here


# Equations too small for a library's call


@njit(cache=True, nogil=True, error_model="numpy")
def factorise(matrix, least=0.0):  # type: ignore[no-untyped-def]
    """Replace a positive definite matrix (k, k) by its Cholesky factor, and return whether all pivots are firm.

    A pivot is firm if subtraction leaves more than the share `least` of it.
    """
    firm = True
    for a in range(len(matrix)):
        for b in range(a + 1):
            total = matrix[a, b]
            for c in range(b):
                total -= matrix[a, c] * matrix[b, c]
            if a == b:
                firm = firm and total > least * matrix[a, a]
                matrix[a, a] = math.sqrt(max(total, 1e-15 * matrix[a, a]))
            else:
                matrix[a, b] = total / matrix[b, b]
    return firm


@njit(cache=True, nogil=True, error_model="numpy")
def substitute(factor, side):  # type: ignore[no-untyped-def]
    """Replace a right-hand side (k,) by the solution of the equations whose matrix has this Cholesky factor."""
    for a in range(len(side)):
        for b in range(a):
            side[a] -= factor[a, b] * side[b]
        side[a] /= factor[a, a]
    for a in range(len(side) - 1, -1, -1):
        for b in range(a + 1, len(side)):
            side[a] -= factor[b, a] * side[b]
        side[a] /= factor[a, a]
