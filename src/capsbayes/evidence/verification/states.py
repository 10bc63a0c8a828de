"""Steady states and their numbers, as the sections compare them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsbayes.errors import CapsbayesError
from capsbayes.parameters import PARAMETERS
from capsbayes.physics.capsule.outlines import profile
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.simulation.simulator import Simulator, SteadyState
from capsbayes.profile import Profile
from capsbayes.status import Status

__all__ = ["QUANTITIES", "SYMBOLS", "iterate_of", "numbers", "outline", "steady"]

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")
SYMBOLS = {name: PARAMETERS[name].symbol for name in QUANTITIES}


def steady(
    simulator: Simulator, capillary_number: float, size_ratio: float, start: SteadyState | None = None
) -> SteadyState:
    """Steady state of a case, from rest or from another, resolved by its mesh or not: its slack tells.

    Raises
    ------
    CapsbayesError
        If it was not found.
    """
    state = simulator.run(
        capillary_number=capillary_number, size_ratio=size_ratio, start="rest" if start is None else start
    )
    on_the_way = not np.isnan(state.limit)  # the branch was left there, before the case
    if not (state.status.ok or (state.status is Status.UNRESOLVED and not on_the_way)):
        raise CapsbayesError(f"Ca = {capillary_number:g}, a/l = {size_ratio:g}: {state.status} {state.detail}".strip())
    return state


def numbers(state: SteadyState) -> dict[str, float]:
    """L_z, L_a and V by name, and the slack."""
    seen = state.profile
    lengths = (seen.axial_extent, seen.axial_length, state.velocity_ratio)
    return dict(zip(QUANTITIES, map(float, lengths), strict=True)) | {"slack": abs(state.slack)}


def iterate_of(problem: Problem, state: SteadyState) -> Iterate:
    """A steady state as the candidate that solves the equations of `problem`."""
    rest = problem.at_rest(state.capillary_number, state.size_ratio)
    return replace(rest, free=state.mesh.reduced(state.nodes), velocity=state.velocity_ratio, slack=state.slack)


def outline(problem: Problem, iterate: Iterate) -> Profile:
    """The profile of a candidate in the plane x = 0."""
    return profile(problem.mesh, problem.mesh.expanded(iterate.free))
