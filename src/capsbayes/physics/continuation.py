"""Branches of steady states: from rest, along Ca and a/l, through folds, and the shape that a capsule settles to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.channel import CircularChannel, FourfoldTube
from capsbayes.physics.load import profile
from capsbayes.physics.steady import (
    REDUCTION,
    FreeMotion,
    Iterate,
    NewtonResult,
    Problem,
    bordered,
    steady_residual,
    steady_state,
)
from capsbayes.physics.surface import prolonged
from capsbayes.physics.transient import growth_rates
from capsbayes.run import remembered
from capsbayes.status import Status

# Trace a branch of steady states through its folds, by pseudo-arclength continuation.
#
# Ca is an unknown like the shape; the extra equation keeps the next state on a plane across the branch's direction, a
# given length ahead (Keller 1977, in Applications of Bifurcation Theory, 359-384). Where Ca turns back the branch has a
# fold: beyond the Ca there it does not exist

_SHAPE_WEIGHT = 60.0  # of the rms displacement over a to log Ca; with 10 the fold of a small dimple is too sharp
_MAX_ITERATIONS = 8
_TOLERANCE = 1e-6
_EASY_STEP = 5  # iterations up to which the next step is longer
_SHORTEST_STEP, _LONGEST_STEP = 1e-3, 2.0


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


def traced(problem: Problem, start: NewtonResult, *, rising: bool = True) -> Iterator[ArcPoint]:
    """Trace the branch of a converged state, itself first, towards larger Ca if rising, until no further is found."""
    step = 0.1  # in units of log Ca, or of a sixtieth of a in the rms displacement
    scale = _scale(problem, start.iterate)
    ahead = np.zeros(len(scale))
    ahead[-1] = 1.0 if rising else -1.0
    _, matrix = _extended(problem, start.iterate, ahead / scale**2)
    along = scipy.linalg.solve(matrix, np.append(np.zeros(len(ahead) - 1), 1.0))
    point = ArcPoint(start, _normalised(along, scale))
    yield point
    while step > _SHORTEST_STEP:
        corrected = _corrected(problem, point, step, scale)
        if corrected is None:
            step /= 2.0
            continue
        point = corrected
        yield point
        if point.result.iterations <= _EASY_STEP:
            step = min(1.5 * step, _LONGEST_STEP)


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


# The steady shape to which a capsule settles from rest.
#
# A hardly deformed capsule is compressed at its rear. A spherical membrane buckles at a compressive tension of 2
# (E B)^(1/2) G_s, with Young's modulus E = 4 K / (K + 1) over G_s, the area dilation modulus K over G_s and the bending
# stiffness B over G_s a^2. From about there on the branch that leads up from rest may be unstable, and other steady
# shapes exist: the motion itself decides which of them the capsule takes. It is followed in time with linearised
# implicit Euler steps, which damp fast decaying modes and let slowly growing ones grow

SHALLOW = 0.1  # largest depth of the rear over a before a snap-through
_STEPS = 100
_LONGEST_TIME = 0.5  # time step U dt / l; instabilities that grow at more than twice its inverse would be damped
_SHORTEST_TIME = 1e-4
_FARTHEST_NODE = 0.05  # over a, of any node in one step
_TOO_LONG = 5.0  # length over a of a capsule that goes on growing
_SLOW = 0.05  # speed below which the steady state is tried


def is_shallow(problem: Problem, iterate: Iterate) -> bool:
    """Return whether the rear is convex, or so little concave that the capsule may still snap through."""
    outline = profile(problem.mesh, problem.mesh.expanded(iterate.free))
    return bool(outline.parachute_depth < SHALLOW * iterate.size_ratio)


def may_buckle(problem: Problem, iterate: Iterate) -> bool:
    """Return whether a shallow shape has at least half the compressive tension at which a sphere buckles."""
    return is_shallow(problem, iterate) and _is_compressed(problem, iterate)


def _is_compressed(problem: Problem, iterate: Iterate) -> bool:
    dilation = problem.law.area_dilation_modulus
    threshold = 2.0 * np.sqrt(4.0 * dilation / (dilation + 1.0) * problem.bending)
    tensions = problem.membrane(iterate.size_ratio).principal_tensions(iterate.free)
    return bool(np.min(tensions) < -0.5 * threshold)


def is_stable(problem: Problem, iterate: Iterate) -> bool:
    """Return whether small disturbances of a steady state that share its symmetry decay."""
    return bool(growth_rates(problem, iterate)[0].real < 0.0)


def wrinkling_rate(problem: Problem, iterate: Iterate) -> float:
    """Compute the growth rate [U/l] of the fastest wrinkles about the axis; NaN where none is to be expected."""
    # None is sought where the shape is not axisymmetric, or hardly compressed. They keep four mirror planes. The mesh
    # decides how short they can be: the rate tells whether there are any, not which.
    if not isinstance(problem.flow, CircularChannel) or not _is_compressed(problem, iterate):
        return float("nan")
    loose = replace(problem, flow=FourfoldTube())
    nodes = problem.mesh.expanded(iterate.free)[problem.mesh.wedge]
    return float(growth_rates(loose, replace(iterate, free=loose.mesh.reduced(nodes)))[0].real)


def settled(problem: Problem, capillary_number: float, size_ratio: float) -> NewtonResult | None:
    """Find the stable steady state to which a capsule settles from rest; None if it does not."""
    here = problem.at_rest_in_channel(capillary_number, size_ratio)
    free, patience = here.free, 0
    for step in range(_STEPS):
        taken = _stepped(problem, here, free)
        if not np.isfinite(taken.speed) or np.ptp(problem.mesh.expanded(free)[:, 2]) > _TOO_LONG * size_ratio:
            return None
        if taken.speed < _SLOW and step >= patience:
            iterate = replace(here, free=free, velocity=taken.velocity, slack=taken.slack)
            result = steady_state(problem, iterate, max_iterations=10, patience=5)
            if result.converged and is_stable(problem, result.iterate):
                return result
            patience = 2 * step
        if taken.free is None:
            return None
        free = taken.free
    return None


class _Step(NamedTuple):
    """Speed, velocity and slack of a shape, and its free coordinates a step later, None if no step is short enough."""

    speed: float
    velocity: float
    slack: float
    free: Floats | None


@remembered
def _stepped(problem: Problem, here: Iterate, free: Floats) -> _Step:
    """Advance a shape at the Ca and a/l of `here` by a linearised implicit step."""
    motion = FreeMotion(problem, here)
    rate, jacobian = motion.linearised(free)
    state = rate.speed, rate.velocity, rate.slack
    if not np.isfinite(rate.speed):
        return _Step(*state, None)
    length, change = _LONGEST_TIME, np.full_like(free, np.inf)
    while not problem.mesh.largest(change) < _FARTHEST_NODE * here.size_ratio:
        change = length * scipy.linalg.solve(np.eye(len(free)) - length * jacobian, rate.change)
        length /= 2.0
        if length < _SHORTEST_TIME:
            return _Step(*state, None)
    return _Step(*state, motion.held(free + change, rate.across))


# Follow branches of steady states: that of a capsule at rest, and that of the parachutes.
#
# At low Ca a capsule has one of two shapes. Followed up from rest its rear stays convex until that branch ends or
# becomes unstable, where a capsule snaps through to a parachute. The parachutes go down to a fold at a lower Ca, so
# that between the two both shapes exist: a capsule started from rest takes the first. In wide capsules, and with enough
# pre-inflation or bending stiffness, one branch leads smoothly from one shape to the other.
#
# Newton's iteration from rest converges at a low Ca. A parachute is found with a
# strong bending stiffness, which is then lowered

SLACK_LIMIT = 5e-4
"""A steady state with a larger slack is not resolved by its mesh."""

_REST = (0.006, 0.75)  # Ca and a/l of the first state near rest
_BENDINGS = (5e-3, 1e-3)
_PARACHUTE = (0.05, 0.8)
_ONE_SHAPE = 0.03  # Ca above which a capsule is taken to be a parachute, whatever wrinkles it may have as well
_COARSE = 6
_AT_ONCE = 0.55  # change of log Ca up to which one step may do
_LONGEST, _SHORTEST = 0.1, 0.005  # first step in a/l, and the one below which a branch is taken to end
_FARTHEST = 0.05  # rms displacement over a by which a state is carried at once
_SMALLEST_SHARE = 0.1  # of the residual, below which a state is not carried further
_EASY = 5  # iterations after which the next step is longer
_USABLE = (Status.DONE, Status.UNRESOLVED)


@dataclass(frozen=True)
class BranchEnd:
    """End of a branch that was followed."""

    result: NewtonResult  # the case asked for if DONE, else the last state before the end
    status: Status  # DONE; UNRESOLVED if the slack is too large; NO_STEADY_STATE beyond a fold; else NOT_CONVERGED
    limit: float = float("nan")  # Ca at the fold in which the branch ended


def followed(problem: Problem, start: NewtonResult, capillary_number: float, size_ratio: float) -> BranchEnd:
    """Follow the branch of a converged state: to a larger size before a larger Ca, to a smaller Ca before a size."""
    legs = [(_along_size, size_ratio), (_upward, capillary_number)]
    if capillary_number < start.iterate.capillary_number:
        legs = [(_along_ca, capillary_number), (_along_size, size_ratio)]
    end = BranchEnd(start, Status.DONE)
    for follow, target in legs:
        end = follow(problem, end.result, target)
        if end.status not in _USABLE:
            break
    return end


def carried(problem: Problem, start: Iterate, capillary_number: float, size_ratio: float) -> BranchEnd:
    """Carry a steady state of other parameters to a case, all parameters at once, with its shape scaled to the size."""
    # Where that leads to no state nearby, the residual that the start has there is removed in shares, each of which is
    # halved until the iteration converges.
    here = replace(_scaled(start, size_ratio), capillary_number=capillary_number)
    trial = _near(problem, here, _FARTHEST) or _in_shares(problem, here)
    if trial is None:
        residual = steady_residual(problem, here)
        failed = NewtonResult(start, False, float(np.max(np.abs(residual))), 0, np.zeros_like(residual))
        return BranchEnd(failed, Status.NOT_CONVERGED)
    end = _reached(trial)
    if end.status is Status.DONE and may_buckle(problem, trial.iterate) and not is_stable(problem, trial.iterate):
        return BranchEnd(trial, Status.UNSTABLE)
    return end


def _in_shares(problem: Problem, here: Iterate) -> NewtonResult | None:
    """Remove the residual of a candidate in shares, halved where Newton's iteration fails, None below the smallest."""
    residual, left, share = steady_residual(problem, here), 1.0, 0.5
    while share >= _SMALLEST_SHARE:
        remaining = max(left - share, 0.0)
        trial = _near(problem, here, _FARTHEST, remaining * residual if remaining else None)
        if trial is None:
            share /= 2.0
        elif not remaining:
            return trial
        else:
            here, left = trial.iterate, remaining
    return None


def reached_from_rest(problem: Problem, capillary_number: float, size_ratio: float) -> BranchEnd:
    """Find the steady state that a capsule started from rest reaches; NOT_CONVERGED where it did not come to rest."""
    if capillary_number > _ONE_SHAPE:
        end = parachute(problem, capillary_number, size_ratio)
        if end.status is not Status.NOT_CONVERGED:
            return end
    start = near_rest(problem, size_ratio)
    if start.status is Status.DONE:
        end = followed(problem, start.result, capillary_number, size_ratio)
        low = capillary_number <= start.result.iterate.capillary_number
        if end.status is Status.DONE and (low or not may_buckle(problem, end.result.iterate)):
            return end
    taken = settled(problem, capillary_number, size_ratio)
    return BranchEnd(start.result, Status.NOT_CONVERGED) if taken is None else _reached(taken)


def parachute(problem: Problem, capillary_number: float, size_ratio: float) -> BranchEnd:
    """Find the parachute at one case."""
    start = _first_parachute(problem, size_ratio)
    return _along_ca(problem, start.result, capillary_number) if start.status in _USABLE else start


@lru_cache(maxsize=64)
def near_rest(problem: Problem, size_ratio: float) -> BranchEnd:
    """Find a steady state at a Ca so low that the capsule is hardly deformed."""
    return _grown(problem, lambda meshed: steady_state(meshed, meshed.at_rest(*_REST)), size_ratio)


@lru_cache(maxsize=64)
def _first_parachute(problem: Problem, size_ratio: float) -> BranchEnd:
    """Find a parachute at Ca = 0.05, with a strong bending stiffness that is lowered."""

    def unbent(problem: Problem) -> NewtonResult:
        start = problem.at_rest(*_PARACHUTE)
        for bending in (value for value in _BENDINGS if value > problem.bending):
            start = steady_state(replace(problem, bending=bending), start, max_iterations=20).iterate
        return steady_state(problem, start, max_iterations=20)

    return _grown(problem, unbent, size_ratio)


def _grown(problem: Problem, first: Callable[[Problem], NewtonResult], size_ratio: float) -> BranchEnd:
    """Continue the first state of a branch to another size, on a coarse mesh if its shape can be prolonged."""
    # On the coarse mesh a step costs a fraction of a second. A shape with a sharp rear rim cannot be prolonged from
    # there.
    if problem.refinement <= _COARSE:
        result = first(problem)
    else:
        coarse = replace(problem, refinement=_COARSE)
        grown = _grown(coarse, first, size_ratio)
        if grown.status in _USABLE:
            fine = _prolonged_state(grown.result, coarse, problem)
            if fine.converged:
                return _reached(fine)
        result = _prolonged_state(first(coarse), coarse, problem)
    return _along_size(problem, result, size_ratio) if result.converged else BranchEnd(result, Status.NOT_CONVERGED)


def _prolonged_state(result: NewtonResult, coarse: Problem, fine: Problem) -> NewtonResult:
    free = prolonged(result.iterate.free, coarse.mesh, fine.mesh)
    return steady_state(fine, replace(result.iterate, free=free), max_iterations=10, patience=6)


def _along_size(problem: Problem, start: NewtonResult, size_ratio: float) -> BranchEnd:
    """Follow a branch at constant Ca, along its tangent, with adaptive steps."""
    whole = size_ratio - start.iterate.size_ratio
    last, step, slope = start, float(np.clip(whole, -_LONGEST, _LONGEST)), None
    while last.iterate.size_ratio != size_ratio:
        here = last.iterate.size_ratio + step
        if abs(step) >= abs(size_ratio - last.iterate.size_ratio) - 1e-9:
            here = size_ratio
        slope = _size_tangent(problem, last.iterate) if slope is None else slope
        scaled = _scaled(last.iterate, here)
        trial = _near(problem, scaled.moved((here - last.iterate.size_ratio) * slope), 0.02)
        if trial is not None:
            last, slope = trial, None
            step *= 1.5 if trial.iterations <= _EASY else 1.0
        else:
            step /= 2.0
            if abs(step) < _SHORTEST:
                return BranchEnd(last, Status.NOT_CONVERGED)
    return _reached(last)


def _scaled(iterate: Iterate, size_ratio: float) -> Iterate:
    return replace(iterate, free=iterate.free * (size_ratio / iterate.size_ratio), size_ratio=size_ratio)


def _size_tangent(problem: Problem, iterate: Iterate) -> Floats:
    """Return the change (F + 2,) of a steady state per unit of a/l, in addition to that of scaling it."""
    change = 1e-4
    matrix = bordered(problem, iterate).matrix
    residual = steady_residual(problem, _scaled(iterate, iterate.size_ratio + change))
    tangent: Floats = -scipy.linalg.solve(matrix, residual / change, overwrite_a=True, check_finite=False)
    return tangent


def _upward(problem: Problem, start: NewtonResult, capillary_number: float) -> BranchEnd:
    """Follow a branch to a larger Ca while it is stable; where it may buckle its corners are too sharp to trace."""
    compressed = may_buckle(problem, start.iterate)
    trial = _at_once(problem, start, capillary_number) if compressed else None
    if compressed and trial is None:
        return BranchEnd(start, Status.UNSTABLE)
    end = _reached(trial) if trial is not None else _along_ca(problem, start, capillary_number)
    reached = end.result.iterate
    if end.status is Status.DONE and may_buckle(problem, reached) and not is_stable(problem, reached):
        return BranchEnd(end.result, Status.UNSTABLE)
    return end


def _at_once(problem: Problem, start: NewtonResult, capillary_number: float) -> NewtonResult | None:
    """Return the state of a branch at another Ca by one step along the tangent, None if it is too far."""
    if abs(np.log(capillary_number / start.iterate.capillary_number)) > _AT_ONCE:
        return None
    moved = start.iterate.moved(start.tangent * (capillary_number - start.iterate.capillary_number))
    predicted = replace(moved, capillary_number=capillary_number)
    return _near(problem, predicted, 0.002 + 0.3 * _displacement(problem, predicted, start.iterate))


def _along_ca(problem: Problem, start: NewtonResult, capillary_number: float) -> BranchEnd:
    """Follow a branch at constant a/l: by one step along the tangent, or by tracing it."""
    if capillary_number == start.iterate.capillary_number:
        return _reached(start)
    trial = _at_once(problem, start, capillary_number)
    if trial is not None:
        return _reached(trial)
    rising = capillary_number > start.iterate.capillary_number
    before: ArcPoint | None = None
    for point in traced(problem, start, rising=rising):
        here = point.result.iterate
        if before is not None and point.rising != rising:
            limit = fold(problem, before, point)
            return BranchEnd(limit.result, Status.NO_STEADY_STATE, limit.result.iterate.capillary_number)
        if (here.capillary_number >= capillary_number) == rising:
            assert before is not None, "the first point is the start, short of the target"
            trial = _near(problem, interpolated(before, point, capillary_number), 0.02)
            return BranchEnd(point.result, Status.NOT_CONVERGED) if trial is None else _reached(trial)
        if abs(here.slack) > SLACK_LIMIT:
            return BranchEnd(point.result, Status.UNRESOLVED, here.capillary_number)
        before = point
    return BranchEnd(start if before is None else before.result, Status.NOT_CONVERGED)


def _near(problem: Problem, start: Iterate, distance: float, offset: Floats | None = None) -> NewtonResult | None:
    """Return the steady state that Newton's iteration finds within a displacement, None beyond: another branch."""
    trial = steady_state(problem, start, max_iterations=12, patience=6, offset=offset)
    near = trial.converged and _displacement(problem, trial.iterate, start) < distance
    return trial if near and abs(trial.iterate.slack) < 20 * SLACK_LIMIT else None


def _displacement(problem: Problem, first: Iterate, second: Iterate) -> float:
    """Return the rms distance over a between two shapes, per coordinate of a node."""
    coordinates = 3 * len(problem.mesh.wedge)
    return float(np.linalg.norm(first.free - second.free)) / (np.sqrt(coordinates) * first.size_ratio)


def _reached(result: NewtonResult) -> BranchEnd:
    """Return the end of a branch at the case asked for, if the mesh resolves it."""
    resolved = abs(result.iterate.slack) < SLACK_LIMIT
    return BranchEnd(result, Status.DONE if resolved else Status.UNRESOLVED)
