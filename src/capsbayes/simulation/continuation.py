"""Follow a branch of steady states from one (Ca, a/l) to another, and find a first one from rest.

Newton's iteration from the unstressed sphere fails; with a strong bending
stiffness it converges, and the bending is then lowered. From there a
straight path in (log Ca, a/l) is followed with the tangent along Ca as
predictor and a step length that adapts to the work of Newton's iteration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capsbayes.simulation.steady_state import Iterate, NewtonResult, SteadyProblem
from capsbayes.surface.prolongation import prolonged

__all__ = ["BranchEnd", "first_state", "followed"]

SLACK_LIMIT = 5e-4
"""A steady state with a larger slack is not resolved by its mesh."""

_BENDINGS = (5e-3, 1e-3)
_START = (0.05, 0.8)
_COARSE = 6


@dataclass(frozen=True)
class BranchEnd:
    """Where following a branch ended: the last converged state and how far along the path it lies (1: the target)."""

    result: NewtonResult
    reached: float


def _predicted(last: NewtonResult, capillary_number: float, size_ratio: float) -> Iterate:
    """The last state moved along its tangent to another Ca and scaled to another size."""
    iterate = last.iterate.moved(last.tangent * (capillary_number - last.iterate.capillary_number))
    return replace(
        iterate,
        free=iterate.free * (size_ratio / iterate.size_ratio),
        capillary_number=capillary_number,
        size_ratio=size_ratio,
    )


def _acceptable(result: NewtonResult) -> bool:
    return result.converged and abs(result.iterate.slack) < 20 * SLACK_LIMIT


def followed(
    problem: SteadyProblem, start: NewtonResult, capillary_number: float, size_ratio: float, *, shortest: float = 0.005
) -> BranchEnd:
    """Follow the branch of `start` along the straight path to (`capillary_number`, `size_ratio`).

    Parameters
    ----------
    problem : SteadyProblem
    start : NewtonResult
        A converged state of the same problem.
    shortest : float
        Length of a step in log Ca and in a/l below which the branch is taken to end.

    Returns
    -------
    BranchEnd
    """
    origin = np.array([np.log(start.iterate.capillary_number), start.iterate.size_ratio])
    target = np.array([np.log(capillary_number), size_ratio])
    length = float(np.max(np.abs(target - origin)))
    last, reached, step = start, 0.0, 1.0
    while reached < 1.0:
        step = min(step, 1.0 - reached)
        log_ca, ratio = origin + (reached + step) * (target - origin)
        here = (capillary_number, size_ratio) if reached + step >= 1.0 else (float(np.exp(log_ca)), float(ratio))
        trial = problem.solve(_predicted(last, *here), max_iterations=8, patience=4)
        if _acceptable(trial):
            last, reached = trial, reached + step
            step *= 2.0 if trial.iterations <= 4 else 1.0
        else:
            step /= 2.0
            if step * length < shortest:
                break
    return BranchEnd(last, min(reached, 1.0))


def first_state(problem: SteadyProblem) -> NewtonResult:
    """A first steady state, of a coarse mesh, at Ca = 0.05 and a/l = 0.8.

    The bending is lowered on a coarse mesh, where a step costs a fraction of a second; this state's rear rim is
    round enough for the coarse shape to start Newton's iteration on the mesh of `problem`. The returned result may
    be unconverged: it is for the caller to judge.
    """
    coarse = replace(problem, refinement=min(_COARSE, problem.refinement))
    start = coarse.at_rest(*_START)
    for bending in (value for value in _BENDINGS if value > problem.bending):
        start = replace(coarse, bending=bending).solve(start, max_iterations=20).iterate
    result = coarse.solve(start, max_iterations=20)
    if coarse.refinement == problem.refinement:
        return result
    free = prolonged(result.iterate.free, coarse.mesh, problem.mesh)
    return problem.solve(replace(result.iterate, free=free), max_iterations=10)
