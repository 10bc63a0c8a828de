"""Motion in time of one capsule."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.errors import CapsbayesError
from capsbayes.physics.steady import FreeMotion, Iterate, Problem, Rate
from capsbayes.run import remembered, step_of

Scheme = Literal["semi-implicit", "explicit"]


class _Change(NamedTuple):
    """Change of shape (F,) in a step, and the step's error over l."""

    shape: Floats
    error: float


Stepper = Callable[[Floats, Rate, float], _Change]
"""From a shape, its rate and the length of a step to the change."""

STEADY = 1e-4
"""Speed of the fastest node over U, relative to the centroid, below which a capsule is steady."""

_GAMMA = 1.0 - np.sqrt(0.5)  # L-stable
_SAFETY, _LARGEST_CHANGE, _SHORTEST = 0.8, 3.0, 1e-7
_MOVED = 0.02  # of the size, after which the Jacobian is renewed


class Instant(NamedTuple):
    """A capsule at the time U t / l: shape, velocity of the centroid, speed of the fastest node relative to it [U]."""

    time: float
    iterate: Iterate
    speed: float


def transient(
    problem: Problem,
    start: Iterate,
    times: Sequence[float],
    *,
    scheme: Scheme = "semi-implicit",
    step: float | None = None,
    tolerance: float = 1e-3,
    steady: float = STEADY,
) -> Iterator[Instant]:
    """Yield a capsule at rising times U t / l, until its fastest node is slower than `steady` [U]."""
    # `step` U dt / l is the largest, by default 0.2, or `stable_step` of the explicit scheme; `tolerance` is the error
    # of one semi-implicit step over l, and infinity keeps the step constant.
    motion = FreeMotion(problem, start)
    explicit = scheme == "explicit"
    advanced: Stepper = partial(_midpoint, motion) if explicit else _Rosenbrock(motion)
    largest = step or (stable_step(problem, start) if explicit else 0.2)
    time, length, free = 0.0, largest, start.free
    rate = _rate(motion, free)
    for target in times:
        while time < target and not rate.speed < steady:
            taken = float((target - time) / np.ceil((target - time) / length - 1e-9))
            change, error = advanced(free, rate, taken)
            if _too_far(change, motion):
                error = np.nan
            length = min(largest, taken * _factor(error, tolerance))
            if error <= 2.0 * tolerance:
                free = motion.held(free + change, rate.across)
                time, rate = (target if taken >= target - time else time + taken), _rate(motion, free)
            elif length < _SHORTEST:
                raise CapsbayesError(f"transient: no step is short enough at U t/l = {time:.4g}; refine the mesh")
        iterate = replace(start, free=free, velocity=rate.velocity, slack=rate.slack)
        yield Instant(time, iterate, rate.speed)
        if rate.speed < steady:
            return


def _rate(motion: FreeMotion, free: Floats) -> Rate:
    return step_of(Rate, ("rate", motion.problem, motion.start, free), motion.rate, free)


def _factor(error: float, tolerance: float) -> float:
    """Return the factor by which the next step is longer."""
    if not np.isfinite(error):
        return 1.0 / _LARGEST_CHANGE
    return float(np.clip(_SAFETY * np.sqrt(tolerance / max(error, 1e-12)), 1.0 / _LARGEST_CHANGE, _LARGEST_CHANGE))


def _too_far(change: Floats, motion: FreeMotion) -> bool:
    """Return whether a node would move by the capsule's radius in one step; such a shape is not computed."""
    return not motion.problem.mesh.largest(change) < motion.start.size_ratio


def _midpoint(motion: FreeMotion, free: Floats, rate: Rate, length: float) -> _Change:
    """Take a step by the explicit midpoint rule; its error is not estimated."""
    half = 0.5 * length * rate.change
    if _too_far(half, motion):
        return _Change(half, np.nan)
    return _Change(length * motion.rate(free + half).change, 0.0)


class _Rosenbrock:
    """ROS2 with a Jacobian that is renewed when the shape has moved; its error is that of the first-order step."""

    def __init__(self, motion: FreeMotion) -> None:
        self.motion = motion
        self.reference: Floats | None = None
        self.jacobian: Floats | None = None

    def __call__(self, free: Floats, rate: Rate, length: float) -> _Change:
        mesh, start = self.motion.problem.mesh, self.motion.start
        if self.reference is None or mesh.largest(free - self.reference) > _MOVED * start.size_ratio:
            self.reference, self.jacobian = free, None
        reference = self.reference
        key = "Rosenbrock", self.motion.problem, start, reference, free, length
        return step_of(_Change, key, self._computed, reference, free, rate, length)

    def _computed(self, reference: Floats, free: Floats, rate: Rate, length: float) -> _Change:
        mesh = self.motion.problem.mesh
        if self.jacobian is None:
            self.jacobian = self.motion.linearised(reference)[1]
        factor = scipy.linalg.lu_factor(np.eye(len(free)) - _GAMMA * length * self.jacobian)
        first = length * scipy.linalg.lu_solve(factor, rate.change)
        if _too_far(first, self.motion):
            return _Change(first, np.nan)
        ahead = length * self.motion.rate(free + first).change
        second = scipy.linalg.lu_solve(factor, ahead - 2.0 * first)
        return _Change(1.5 * first + 0.5 * second, 0.5 * mesh.largest(first + second))


def stable_step(problem: Problem, start: Iterate) -> float:
    """Return a time step U dt / l for the explicit scheme: 1.4 over the fastest rate; it is stable up to 2."""
    # The fastest rate, about n / (Ca a/l) (2 (K_s + 1) + 140 B n^2), was measured for refinement n from 4 to 12: right
    # to 25 % at rest, too large at steady states and with the energy of curvature (at B = 5e-3 by 1.6 to 2.8), and too
    # small by up to 25 % for a large capsule squeezed into the channel.
    n = problem.refinement
    stiffness = problem.law.area_dilation_modulus + 1.0 + 70.0 * problem.bending * n**2
    return 0.7 * start.capillary_number * start.size_ratio / (n * stiffness)


@remembered
def growth_rates(problem: Problem, iterate: Iterate) -> NDArray[np.complex128]:
    """Compute the rates (F - c,) [U/l] at which small disturbances of a steady state grow, the fastest first."""
    # One for each independent change of shape that keeps volume and centroid.
    motion = FreeMotion(problem, iterate)
    allowed = motion.changes(iterate.free)
    matrix = allowed.T @ motion.linearised(iterate.free)[1] @ allowed
    rates: NDArray[np.complex128] = np.linalg.eigvals(matrix).astype(complex)
    return rates[np.argsort(-rates.real)]
