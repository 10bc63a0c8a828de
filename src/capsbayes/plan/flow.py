"""Choice of the flow rate at which the posterior of G_s of the expected capsules is narrowest.

A slow flow tells little of a membrane, and too strong a flow has no steady
shape. For each mean velocity U the expected width of G_s is averaged over the
capsules that are expected; the best U is that of the smallest width among
those at which the capsules stay below the limit of existence by a margin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer.prior import Prior
from capsbayes.infer.verdict import LEANING_SHARE
from capsbayes.model import ForwardModel
from capsbayes.plan.borders import range_at
from capsbayes.plan.design import FlowDesign, FlowPoint
from capsbayes.plan.expectation import Draws, Expectation
from capsbayes.plan.identifiability import Progress, lab_attributes
from capsbayes.plan.lab_errors import LabErrors
from capsbayes.plan.width_table import WidthTable
from capsbayes.plan.widths import NOISES, WidthPredictor
from capsbayes.quantity import Given
from capsbayes.status import Status

MARGIN = 0.1
"""Share of the Ca at the limit of existence by which capsules are to stay below it."""

RISK = 0.05
"""Probability that a capsule comes nearer to the limit than that."""

_POINTS = 96  # velocities
_DRAWS = 4000


def flow_rate(mean_velocity: float, half_width: float, cross_section: str) -> float:
    """Return the flow rate Q of a mean velocity U [m^3/s]: U (2l)^2 in a square channel, U pi l^2 in a circular one.

    >>> round(6e10 * flow_rate(5e-3, 25e-6, "square"), 3)  # in uL/min
    0.75
    """
    return mean_velocity * half_width**2 * {"square": 4.0, "circular": float(np.pi)}[cross_section]


@checked
def flow_design(
    surface_shear_modulus: Given,
    capsule_radius: Given,
    experiment: Experiment,
    errors: LabErrors,
    model: ForwardModel,
    *,
    seed: int,
    margin: float = MARGIN,
    risk: float = RISK,
    noises: int = NOISES,
    prior: Prior | None = None,
    progress: Progress | None = None,
) -> FlowDesign:
    """Choose the flow rate for capsules of expected G_s and a.

    Parameters
    ----------
    surface_shear_modulus, capsule_radius : Quantity [N/m], [m]
        Expected G_s and a; `Quantity.of` says in which forms.
    experiment : Experiment
        Channel and liquid, with their errors.
    errors : LabErrors
        Of the lengths and of the velocity.
    model : ForwardModel
    seed : int
        Of the capsules drawn; stored in the result.
    margin : float
        Share of the Ca at the limit of existence by which capsules are to stay below it.
    risk : float
        Probability that a capsule comes nearer.
    noises : int
        Measurements that each width is averaged over.
    prior : Prior, optional
        With which the capsules will be identified.
    progress : callable, optional
        Wraps the iterable of computed points to show progress, see `capsbayes.plan.identifiability.Progress`.

    Returns
    -------
    FlowDesign

    Raises
    ------
    InputError
        If an argument cannot be used, or the model has no shape of the expected size.
    """
    if not (0.0 <= margin < 1.0 and 0.0 <= risk < 1.0):
        raise InputError("flow_design", "margin, risk", "shares from 0 to below 1", f"{margin:g}, {risk:g}")
    expectation = Expectation.of(surface_shear_modulus, capsule_radius, experiment)
    centre = expectation.centre
    here = range_at(model, float(centre.size_ratio[0]))
    if here.empty:
        low, high = model.domain.bounds[1]
        wanted = f"a radius between {low:.4g} and {high:.4g} l, as {model.name} has them"
        raise InputError("flow_design", "capsule_radius", wanted, f"a/l = {here.size_ratio:.4g}")
    expected_modulus = float(centre.surface_shear_modulus[0])
    predictor = WidthPredictor(
        model, experiment, errors, prior=prior, surface_shear_modulus=expected_modulus, noises=noises
    )
    capsules = expectation.drawn(np.random.default_rng(seed), _DRAWS)
    with threadpool_limits(limits=1):
        table = WidthTable.of(predictor, capsules.size_ratio, progress)
    per_ca = float(
        imposed_velocity(viscosity=centre.viscosity[0], capillary_number=1.0, surface_shear_modulus=expected_modulus)
    )
    velocities = per_ca * here.inner(_POINTS)
    expected = [
        _expected(velocity, table, capsules, centre, model, margin, experiment.cross_section) for velocity in velocities
    ]
    points, status = _judged(expected, risk)
    allowed = [point for point in points if point.allowed]
    return FlowDesign(
        points=points,
        best=min(allowed, key=lambda point: point.relative) if allowed else None,
        limit=here,
        limit_velocity=per_ca * here.highest,
        expectation=expectation,
        margin=margin,
        risk=risk,
        lab=lab_attributes(model, experiment, errors),
        seed=seed,
        status=status,
    )


def _expected(
    velocity: float,
    table: WidthTable,
    capsules: Draws,
    centre: Draws,
    model: ForwardModel,
    margin: float,
    cross_section: str,
) -> FlowPoint:
    """Return the expectation at one velocity, not yet marked as allowed."""
    ca, size = capsules.capillary_number(velocity), capsules.size_ratio
    has_shape = model.domain.contains(ca, size)
    highest = table.highest(size)
    widths = {
        name: float(np.mean(width[has_shape])) if has_shape.any() else np.nan
        for name, width in table.at(ca, size).items()
    }
    middle = {"capillary_number": centre.capillary_number(velocity), "size_ratio": centre.size_ratio}
    return FlowPoint(
        mean_velocity=float(velocity),
        flow_rate=flow_rate(float(velocity), float(centre.half_width[0]), cross_section),
        capillary_number=float(middle["capillary_number"][0]),
        capsule_velocity=float(velocity * model(middle).velocity_ratio[0]),
        **widths,
        beyond_limit=float(np.mean(ca > highest)),
        beyond_margin=float(np.mean(ca > (1.0 - margin) * highest)),
        without_shape=float(np.mean(~has_shape)),
        allowed=False,
    )


def _judged(expected: list[FlowPoint], risk: float) -> tuple[tuple[FlowPoint, ...], Status]:
    """Mark the velocities that may be chosen: below the limit, with widths that the border does not cut."""
    below = [point.beyond_margin <= risk and bool(np.isfinite(point.relative)) for point in expected]
    measured = [fine and point.leaning <= LEANING_SHARE for fine, point in zip(below, expected, strict=True)]
    status = Status.DONE if any(measured) else Status.LEANS_ON_BORDER if any(below) else Status.NO_FLOW_RATE
    chosen = measured if any(measured) else below
    return tuple(replace(point, allowed=fine) for point, fine in zip(expected, chosen, strict=True)), status
