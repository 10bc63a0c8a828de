"""The steady shape to which a capsule settles from rest.

A hardly deformed capsule is compressed at its rear. A spherical membrane
buckles at a compressive tension of 2 (E B)^(1/2) G_s, with Young's modulus
E = 4 K / (K + 1) over G_s, the area dilation modulus K over G_s and the bending
stiffness B over G_s a^2. From about there on the branch that leads up from rest
may be unstable, and other steady shapes exist: the motion itself decides which
of them the capsule takes. It is followed in time with linearised implicit Euler
steps, which damp fast decaying modes and let slowly growing ones grow.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.physics.capsule.free_motion import FreeMotion
from capsbayes.physics.capsule.outlines import profile
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.capsule.steady_state import NewtonResult, steady_state
from capsbayes.physics.capsule.transient import growth_rates
from capsbayes.physics.stokes.circular import CircularChannel, FourfoldTube
from capsbayes.work import remembered

SHALLOW = 0.1  # largest depth of the rear over a before a snap-through
_STEPS = 100
_LONGEST = 0.5  # time step U dt / l; instabilities that grow at more than twice its inverse would be damped
_SHORTEST = 1e-4
_FARTHEST = 0.05  # over a, of any node in one step
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
    length, change = _LONGEST, np.full_like(free, np.inf)
    while not problem.mesh.largest(change) < _FARTHEST * here.size_ratio:
        change = length * scipy.linalg.solve(np.eye(len(free)) - length * jacobian, rate.change)
        length /= 2.0
        if length < _SHORTEST:
            return _Step(*state, None)
    return _Step(*state, motion.held(free + change, rate.across))
