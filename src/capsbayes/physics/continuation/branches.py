"""Follow branches of steady states: that of a capsule at rest, and that of the parachutes.

At low Ca a capsule has one of two shapes. Followed up from rest its rear stays
convex until that branch ends or becomes unstable, where a capsule snaps through
to a parachute. The parachutes go down to a fold at a lower Ca, so that between
the two both shapes exist: a capsule started from rest takes the first. In wide
capsules, and with enough pre-inflation or bending stiffness, one branch leads
smoothly from one shape to the other.

Newton's iteration from rest converges at a low Ca. A parachute is found with a
strong bending stiffness, which is then lowered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.capsule.steady_state import NewtonResult, bordered, steady_residual, steady_state
from capsbayes.physics.continuation.arclength import ArcPoint, fold, interpolated, traced
from capsbayes.physics.continuation.settling import is_stable, may_buckle, settled
from capsbayes.physics.surface.octasphere import prolonged
from capsbayes.status import Status

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
    trial = _near(problem, here, _FARTHEST)
    if trial is None:
        trial = _in_shares(problem, here)
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

    def smallest(problem: Problem) -> NewtonResult:
        return steady_state(problem, problem.at_rest(*_REST))

    return _grown(problem, smallest, size_ratio)


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
    predicted = _predicted(start, capillary_number)
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


def _predicted(last: NewtonResult, capillary_number: float) -> Iterate:
    """Move a state along its tangent to another Ca."""
    moved = last.iterate.moved(last.tangent * (capillary_number - last.iterate.capillary_number))
    return replace(moved, capillary_number=capillary_number)


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
