"""Derivatives of a steady state along its parameters: Ca, a/l and those of the membrane.

Where the residual R(y; p) of shape, velocity and slack y vanishes, dy/dp = -(dR/dy)^-1 dR/dp with the exact matrix of
Newton's method. All parameters share its factors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.capsule.steady_state import bordered, steady_residual

_STEP = 1e-5  # of parameters, for the differences of the density or of the residual


def changed(problem: Problem, name: str, value: float) -> Problem:
    """Return the problem with another value of a parameter of the membrane: its law's, its bending or its inflation."""
    if _of_law(problem, name):
        return replace(problem, law=replace(problem.law, **{name: value}))
    return replace(problem, **{name: value})  # type: ignore[arg-type]


def value_of(problem: Problem, name: str) -> float:
    """Return the value of a parameter of the membrane.

    Raises
    ------
    InputError
        If neither the problem nor its law has it.
    """
    owner = problem.law if _of_law(problem, name) else problem
    value = getattr(owner, name, None)
    if not isinstance(value, float):
        raise InputError("parameter", "", "a parameter of the membrane or of its law", repr(name))
    return value


def _of_law(problem: Problem, name: str) -> bool:
    return name in (item.name for item in fields(problem.law))


def parameter_derivatives(problem: Problem, iterate: Iterate, names: Sequence[str]) -> Floats:
    """Compute the derivatives (F + 2, p) of shape, velocity and slack of a steady state along some parameters.

    Parameters
    ----------
    problem : Problem
    iterate : Iterate
        A converged steady state.
    names : sequence of str
        ``"capillary_number"``, ``"size_ratio"``, or parameters of the problem or of its law, as ``"pre_inflation"``,
        ``"bending"`` or ``"strain_hardening"``.
    """
    linearised = bordered(problem, iterate)
    along = np.zeros((len(iterate.free) + 2, len(names)))
    for column, name in enumerate(names):
        if name == "capillary_number":
            along[:, column] = linearised.along_ca
        elif name == "size_ratio":
            size = iterate.size_ratio
            ends = [replace(iterate, size_ratio=size + step) for step in (-_STEP, _STEP)]
            below, above = (steady_residual(problem, end) for end in ends)
            along[:, column] = (above - below) / (2.0 * _STEP)
        else:
            along[:-2, column] = linearised.along_density @ _density_slope(problem, iterate, name)
    return -scipy.linalg.solve(linearised.matrix, along, overwrite_a=True, check_finite=False)


def _density_slope(problem: Problem, iterate: Iterate, name: str) -> Floats:
    """Return the derivative (F,) of the density along a parameter of the membrane, at constant shape."""
    value = value_of(problem, name)
    densities, values = [], []
    for end in (value - _STEP, value + _STEP):
        try:
            values.append(end)
            other = changed(problem, name, end)
        except InputError:  # beyond the range of the parameter
            values[-1], other = value, problem
        gradient = other.membrane(iterate.size_ratio).gradient(iterate.free)
        densities.append(other.density(iterate, gradient))
    return (densities[1] - densities[0]) / (values[1] - values[0])
