"""Trace a branch of steady states through its folds, by pseudo-arclength continuation.

Ca is an unknown like the shape; the extra equation keeps the next state on a
plane across the branch's direction, a given length ahead (Keller 1977, in
Applications of Bifurcation Theory, 359-384). Where Ca turns back the branch has
a fold: beyond the Ca there it does not exist.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.capsule.steady_state import REDUCTION, NewtonResult, bordered, steady_residual
from capsbayes.work import remembered

_SHAPE_WEIGHT = 60.0  # of the rms displacement over a to log Ca; with 10 the fold of a small dimple is too sharp
_MAX_ITERATIONS = 8
_TOLERANCE = 1e-6
_EASY = 5  # iterations up to which the next step is longer
_SHORTEST, _LONGEST = 1e-3, 2.0


class ArcPoint(NamedTuple):
    """A steady state, and the direction (F + 3,) of the branch there: shape, velocity, slack and log Ca."""

    result: NewtonResult
    direction: Floats

    @property
    def log_ca(self) -> float:
        """Logarithm of Ca."""
        return float(np.log(self.result.iterate.capillary_number))

    @property
    def rising(self) -> bool:
        """True if Ca grows along the direction."""
        return bool(self.direction[-1] > 0.0)


def traced(problem: Problem, start: NewtonResult, *, rising: bool = True, step: float = 0.1) -> Iterator[ArcPoint]:
    """Trace the branch of a converged state, itself first, towards larger Ca if rising, until no further is found."""
    # The first length `step` is in units of log Ca, or of a sixtieth of a in the rms displacement.
    sense = 1.0 if rising else -1.0
    scale = _scale(problem, start.iterate)
    ahead = np.zeros(len(scale))
    ahead[-1] = sense
    point = ArcPoint(start, _direction(problem, start.iterate, ahead, scale))
    yield point
    while step > _SHORTEST:
        corrected = _corrected(problem, point, step, scale)
        if corrected is None:
            step /= 2.0
            continue
        point = corrected
        yield point
        if point.result.iterations <= _EASY:
            step = min(1.5 * step, _LONGEST)


def fold(problem: Problem, before: ArcPoint, after: ArcPoint) -> ArcPoint:
    """Find the state where Ca is extreme, between two successive points with directions of different sense."""
    # Ca is taken as a cubic of the arc length between the two; the state there is corrected once, and its Ca is off by
    # no more than the fourth power of their distance.
    scale = _scale(problem, before.result.iterate)
    length = float(np.linalg.norm((_vector(after.result.iterate) - _vector(before.result.iterate)) / scale))
    start, end = before.direction[-1], after.direction[-1]
    rise = (after.log_ca - before.log_ca) / length
    # slope of the cubic over the share t of the length
    roots = np.roots([3.0 * (start + end - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * start - end), start])
    inside = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and 0.0 < root.real < 1.0]
    share = inside[0] if inside else float(start / (start - end))
    nearer, step = (before, share * length) if share <= 0.5 else (after, (share - 1.0) * length)
    corrected = _corrected(problem, nearer, step, scale)
    candidates = [before, after] if corrected is None else [before, after, corrected]
    sense = 1.0 if before.rising else -1.0
    return max(candidates, key=lambda point: sense * point.log_ca)


def interpolated(before: ArcPoint, after: ArcPoint, capillary_number: float) -> Iterate:
    """Interpolate a candidate at a Ca between two successive points of rising or falling Ca, by a cubic of log Ca."""
    length = after.log_ca - before.log_ca
    share = (np.log(capillary_number) - before.log_ca) / length
    start, end = _vector(before.result.iterate), _vector(after.result.iterate)
    start_slope, end_slope = (length * point.direction / point.direction[-1] for point in (before, after))
    change = (
        share**2 * (3.0 - 2.0 * share) * (end - start)
        + share * (1.0 - share) ** 2 * start_slope
        - share**2 * (1.0 - share) * end_slope
    )
    return replace(before.result.iterate.moved(change[:-1]), capillary_number=capillary_number)


def _scale(problem: Problem, iterate: Iterate) -> Floats:
    """Return the units (F + 3,) of lengths along the branch; velocity and slack do not count."""
    shape = np.sqrt(len(problem.mesh.wedge)) * iterate.size_ratio / _SHAPE_WEIGHT
    return np.concatenate([np.full(len(iterate.free), shape), [np.inf, np.inf, 1.0]])


def _vector(iterate: Iterate) -> Floats:
    return np.concatenate([iterate.free, [iterate.velocity, iterate.slack, np.log(iterate.capillary_number)]])


def _moved(iterate: Iterate, change: Floats) -> Iterate:
    return replace(iterate.moved(change[:-1]), capillary_number=iterate.capillary_number * float(np.exp(change[-1])))


def _extended(problem: Problem, iterate: Iterate, row: Floats) -> tuple[Floats, Floats]:
    """Return the residual (F + 2,) and the matrix (F + 3, F + 3) with the column of log Ca and a given last row."""
    linearised = bordered(problem, iterate)
    count = len(row)
    matrix = np.empty((count, count))
    matrix[:-1, :-1], matrix[:-1, -1] = linearised.matrix, linearised.along_ca * iterate.capillary_number
    matrix[-1] = row
    return linearised.residual, matrix


def _direction(problem: Problem, iterate: Iterate, ahead: Floats, scale: Floats) -> Floats:
    """Return the direction of the branch at a steady state, on the same side as `ahead`."""
    _, matrix = _extended(problem, iterate, ahead / scale**2)
    return _normalised(scipy.linalg.solve(matrix, np.append(np.zeros(len(ahead) - 1), 1.0)), scale)


def _normalised(direction: Floats, scale: Floats) -> Floats:
    unit: Floats = direction / np.linalg.norm(direction / scale)
    return unit


@remembered
def _corrected(problem: Problem, point: ArcPoint, step: float, scale: Floats) -> ArcPoint | None:
    """Return the state `step` ahead of a point, None if Newton's iteration finds none near the prediction."""
    # Derivatives are kept while a step with them reduces the residual to a tenth.
    row = point.direction / scale**2
    iterate = _moved(point.result.iterate, step * point.direction)
    predicted, factor, size = _vector(iterate), None, np.inf
    for iteration in range(1, _MAX_ITERATIONS + 1):
        before = size
        if factor is not None:
            residual = steady_residual(problem, iterate)
            size = float(np.max(np.abs(residual)))
        if factor is None or size > REDUCTION * before:
            residual, matrix = _extended(problem, iterate, row)
            size = float(np.max(np.abs(residual)))
            if not np.isfinite(size):
                return None
            factor = scipy.linalg.lu_factor(matrix, overwrite_a=True, check_finite=False)
        if size < _TOLERANCE:
            along = scipy.linalg.lu_solve(factor, np.append(np.zeros(len(row) - 1), 1.0), check_finite=False)
            direction = _normalised(along, scale)
            along_ca = direction[:-1] / (direction[-1] * iterate.capillary_number)
            return ArcPoint(NewtonResult(iterate, True, size, iteration, along_ca), direction)
        gap = row @ (_vector(iterate) - predicted)
        iterate = _moved(iterate, scipy.linalg.lu_solve(factor, -np.append(residual, gap), check_finite=False))
        if not np.linalg.norm((_vector(iterate) - predicted) / scale) < abs(step):
            return None
    return None
