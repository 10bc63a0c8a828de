"""Newton's method for the steady shape of a capsule on the axis of a channel.

The velocity error (see `capsbayes.physics.capsule.problem`) is bordered by
the conditions of constant volume and of a centroid at z = 0. The Jacobian is
exact: elastic tangent, motion of targets and of sources in the kernel, gradient
of the undisturbed flow, and the response of the walls to all of these.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.membrane_load import Enclosure
from capsbayes.physics.capsule.problem import Iterate, Motion, Problem
from capsbayes.work import remembered

REDUCTION = 0.1  # factor by which a step must lower the residual for its derivatives to be kept
_DIVERGED = 100.0  # times the smallest residual
_KEEP_BELOW = 1e-2  # residual above which they are never kept


class NewtonResult(NamedTuple):
    """End of Newton's iteration."""

    iterate: Iterate
    converged: bool
    residual: float
    iterations: int
    tangent: Floats  # (F + 2,): change of shape, velocity and slack per unit of Ca at the last step taken


class Bordered(NamedTuple):
    """Velocity errors with the gaps of volume and centroid, and their derivatives."""

    residual: Floats  # (F + 2,)
    matrix: Floats  # (F + 2, F + 2): along shape, velocity and slack
    along_ca: Floats  # (F + 2,)
    along_density: Floats  # (F, F): of the velocity errors


def bordered(problem: Problem, iterate: Iterate) -> Bordered:
    """Linearise the equations of a steady state at a candidate."""
    motion, slopes = problem.linearised(iterate)
    inside = problem.membrane(iterate.size_ratio).enclosure(iterate.free)
    count = len(iterate.free)
    matrix = np.zeros((count + 2, count + 2))
    matrix[:count, :count] = slopes.along_shape
    matrix[:count, count], matrix[:count, count + 1] = -motion.axial, motion.normal
    matrix[count, :count], matrix[count + 1, :count] = inside.volume_gradient, inside.moment_gradient
    along_ca = np.append(slopes.along_ca, [0.0, 0.0])
    return Bordered(_residual(motion, inside, iterate.size_ratio), matrix, along_ca, slopes.along_density)


def steady_residual(problem: Problem, iterate: Iterate) -> Floats:
    """Compute the velocity errors of a candidate with the gaps of volume and centroid (F + 2,)."""
    inside = problem.membrane(iterate.size_ratio).enclosure(iterate.free)
    return _residual(problem.motion(iterate), inside, iterate.size_ratio)


def _residual(motion: Motion, inside: Enclosure, size_ratio: float) -> Floats:
    volume = 4.0 / 3.0 * np.pi * size_ratio**3
    return np.append(motion.error, [inside.volume - volume, inside.moment])


@remembered
def steady_state(
    problem: Problem,
    start: Iterate,
    *,
    tolerance: float = 1e-7,
    max_iterations: int = 14,
    patience: int | None = None,
    offset: Floats | None = None,
    report: Callable[[int, float, Iterate], None] | None = None,
) -> NewtonResult:
    """Find a steady state by Newton's iteration from `start`, at its Ca and a/l, with steps of at most 0.15 a."""
    # Derivatives cost three times as much as the error, so they are kept while a step brings it down to a tenth. Given
    # up at a hundred times the smallest residual, or above 1e-2 after `patience` steps. `offset` (F + 2,): residual
    # sought.
    iterate, count, size, smallest = start, len(start.free), np.inf, np.inf
    tangent = np.zeros(count + 2)
    factor = None
    for iteration in range(max_iterations + 1):
        before, linearised = size, None
        if factor is None:
            linearised = bordered(problem, iterate)
            residual = linearised.residual
        else:
            residual = steady_residual(problem, iterate)
        if offset is not None:
            residual = residual - offset
        size = float(np.max(np.abs(residual)))
        if report is not None:
            report(iteration, size, iterate)
        smallest = min(size, smallest)
        if not size <= _DIVERGED * smallest:
            break
        if size < tolerance and iteration > 0:
            return NewtonResult(iterate, True, size, iteration, tangent)
        if iteration == max_iterations or (patience is not None and iteration >= patience and size > 1e-2):
            break
        if factor is None or size > REDUCTION * before:
            linearised = linearised or bordered(problem, iterate)
            factor = scipy.linalg.lu_factor(linearised.matrix, overwrite_a=True, check_finite=False)
            tangent = scipy.linalg.lu_solve(factor, -linearised.along_ca, check_finite=False)
        if iteration == 0 and size < tolerance:
            return NewtonResult(iterate, True, size, iteration, tangent)
        step = scipy.linalg.lu_solve(factor, -residual, check_finite=False)
        length = 0.15 * start.size_ratio / problem.mesh.largest(step[:count])
        iterate = iterate.moved(min(1.0, length) * step)
        if size > _KEEP_BELOW:
            factor = None
    return NewtonResult(iterate, False, size, iteration, tangent)
