"""Steady states with the quantities that topics compare, and fitted rates of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.optimize
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from capsbayes.errors import CapsbayesError
from capsbayes.parameters import PARAMETERS
from capsbayes.physics.simulator import Simulator, SteadyState
from capsbayes.physics.steady import Iterate, Problem
from capsbayes.status import Status

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")
SYMBOLS = {name: PARAMETERS[name].symbol for name in QUANTITIES}


def steady(
    simulator: Simulator, capillary_number: float, size_ratio: float, start: SteadyState | None = None
) -> SteadyState:
    """Return the steady state of a case, from rest or from another state; raise if none is found."""
    # A state that its mesh does not resolve is returned too; its slack shows it.
    state = simulator.run(
        capillary_number=capillary_number, size_ratio=size_ratio, start="rest" if start is None else start
    )
    left_early = not np.isnan(state.limit)  # the branch ended before the case
    if not (state.status.ok or (state.status is Status.UNRESOLVED and not left_early)):
        raise CapsbayesError(f"Ca = {capillary_number:g}, a/l = {size_ratio:g}: {state.status} {state.detail}".strip())
    return state


def numbers(state: SteadyState) -> dict[str, float]:
    """Return L_z, L_a and V by name, and the slack."""
    values = (state.profile.axial_extent, state.profile.axial_length, state.velocity_ratio)
    return dict(zip(QUANTITIES, map(float, values), strict=True)) | {"slack": abs(state.slack)}


def iterate_of(problem: Problem, state: SteadyState) -> Iterate:
    """Return a steady state as the candidate that solves the equations of `problem`."""
    rest = problem.at_rest(state.capillary_number, state.size_ratio)
    return replace(rest, free=state.mesh.reduced(state.nodes), velocity=state.velocity_ratio, slack=state.slack)


def on_mesh(refinement: int) -> str:
    """Return the name of the item that is computed on a mesh."""
    return f"n = {refinement}"


class Limit(NamedTuple):
    """The q and p of values q + c n^-p."""

    value: float
    rate: float


def fitted_rate(refinements: ArrayLike, errors: ArrayLike) -> float:
    """Fit the exponent p of errors c n^-p, by least squares of the logarithms; NaN if an error is.

    >>> round(fitted_rate([4, 8], [1.0, 0.125]), 6)
    3.0
    """
    x, y = np.log(refinements), np.log(np.abs(errors))
    return float(-np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2))


def fitted_limit(refinements: ArrayLike, values: ArrayLike) -> Limit:
    """Fit limit and rate of values q + c n^-p, by least squares; NaN if a value is.

    >>> n = np.array([6.0, 8.0, 12.0, 16.0])
    >>> limit = fitted_limit(n, 2.0 + 3.0 * n**-2.5)
    >>> round(limit.value, 6), round(limit.rate, 3)
    (2.0, 2.5)
    """
    n, y = np.asarray(refinements, dtype=float), np.asarray(values, dtype=float)
    if not np.all(np.isfinite(y)):
        return Limit(np.nan, np.nan)

    def fit(rate: float) -> tuple[np.ndarray, float]:
        shapes = np.column_stack([np.ones_like(n), (n / n[0]) ** -rate])
        coefficients = np.linalg.lstsq(shapes, y, rcond=None)[0]
        return coefficients, float(np.sum((shapes @ coefficients - y) ** 2))

    grid = np.linspace(0.3, 9.0, 88)  # the misfit may have several minima
    best = grid[np.argmin([fit(rate)[1] for rate in grid])]
    end = scipy.optimize.minimize_scalar(
        lambda rate: fit(rate)[1], bounds=(best - 0.2, best + 0.2), method="bounded", options={"xatol": 1e-6}
    )
    return Limit(float(fit(end.x)[0][0]), float(end.x))


def label_refinements(axes: Axes, refinements: Sequence[int], label: str) -> None:
    """Label logarithmic axes whose abscissa is the refinement of the mesh."""
    axes.set(xlabel="refinement $n$", ylabel=label, xticks=refinements, xticklabels=map(str, refinements))
    axes.minorticks_off()
    axes.legend()
