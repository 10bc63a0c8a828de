"""Derivatives of a steady state along its parameters: Ca, a/l and those of the membrane.

Where the residual R(y; p) of shape, velocity and slack y vanishes, dy/dp = -(dR/dy)^-1 dR/dp with the exact matrix of
Newton's method. All parameters share its factors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.capsule.parameters import changed, parameters_of
from capsbayes.physics.capsule.problem import Iterate, Problem
from capsbayes.physics.capsule.steady_state import bordered

_STEP = 1e-5  # of parameters, for the differences of the density


def parameter_derivatives(problem: Problem, iterate: Iterate, names: Sequence[str]) -> Floats:
    """Compute the derivatives (F + 2, p) of a converged steady state along parameters of problem or law."""
    linearised = bordered(problem, iterate)
    along = np.zeros((len(iterate.free) + 2, len(names)))
    for column, name in enumerate(names):
        if name == "capillary_number":
            along[:, column] = linearised.along_ca
        else:
            along[:-2, column] = linearised.along_density @ _density_slope(problem, iterate, name)
        if name == "size_ratio":
            along[-2, column] = -4.0 * np.pi * iterate.size_ratio**2  # of the volume
    return -scipy.linalg.solve(linearised.matrix, along, overwrite_a=True, check_finite=False)


def _density_slope(problem: Problem, iterate: Iterate, name: str) -> Floats:
    """Return the derivative (F,) along a parameter, at constant shape, of the density on the sphere of radius a/l."""
    # On spheres of other radii the density counts by their area, with which the velocity is proportional to it.
    known = {"size_ratio": iterate.size_ratio, **parameters_of(problem)}
    if name not in known:
        raise InputError("parameter", "", f"one of {', '.join(known)}", repr(name))
    value = known[name]
    densities, values = [], []
    for end in (value - _STEP, value + _STEP):
        other, there = problem, iterate
        try:
            if name == "size_ratio":
                there = replace(iterate, size_ratio=end)
            else:
                other = changed(problem, name, end)
            values.append(end)
        except InputError:  # beyond the range of the parameter
            values.append(value)
        gradient = other.membrane(there.size_ratio).gradient(there.free)
        densities.append(other.density(there, gradient) * (there.size_ratio / iterate.size_ratio) ** 2)
    return (densities[1] - densities[0]) / (values[1] - values[0])
