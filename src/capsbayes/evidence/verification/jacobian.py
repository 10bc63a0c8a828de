"""The derivatives in Newton's method against central differences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from capsbayes.evidence.verification.row import Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.evidence.verification.states import iterate_of, steady
from capsbayes.physics.simulation.simulator import Simulator

__all__ = ["section"]

_CASE, _STEP = (0.05, 0.9), 1e-6
_WAYS = ("stretching the rear", "third powers", "Ca")
_ITEM = "derivatives"


def section(refinement: int = 6) -> Section:
    """Along two smooth changes of shape and along Ca, at a steady state."""
    return Section(
        "jacobian",
        "Newton's Jacobian",
        "At the steady state of Ca = {:g}, a/l = {:g}, refinement {}: largest difference of the velocity errors' "
        "derivative from central differences, over its largest value. Left out on both sides: the turning of the "
        "normals along which the slack acts, which the derivatives neglect.".format(*_CASE, refinement),
        {_ITEM: partial(_differences, refinement)},
        _rows,
    )


def _differences(refinement: int) -> Values:
    simulator = Simulator(refinement=refinement)
    problem = simulator.problem
    iterate = replace(iterate_of(problem, steady(simulator, *_CASE)), slack=0.0)
    _, slopes = problem.linearised(iterate)
    mesh = problem.mesh
    x, y, z = mesh.nodes[mesh.wedge].T
    fields = (np.column_stack([x * z, y * z, np.cos(3.0 * z)]), np.column_stack([x**3, y**3, z**2]))
    compared = []
    for direction in map(mesh.reduced, fields):
        ends = [replace(iterate, free=iterate.free + step * direction) for step in (_STEP, -_STEP)]
        compared.append((slopes.along_shape @ direction, ends))
    ends = [replace(iterate, capillary_number=iterate.capillary_number + step) for step in (_STEP, -_STEP)]
    compared.append((slopes.along_ca, ends))
    errors = {}
    for way, (exact, (ahead, behind)) in zip(_WAYS, compared, strict=True):
        difference = (problem.motion(ahead).error - problem.motion(behind).error) / (2.0 * _STEP)
        errors[way] = float(np.max(np.abs(exact - difference)) / np.max(np.abs(difference)))
    return errors


def _rows(results: Results) -> Iterator[Row]:
    for way in _WAYS:
        yield Row(f"along {way}: relative difference", results.value(_ITEM, way), target=Target("at most", 1e-6))
