"""Checks of a measurement against the model and the priors: predictive p-values, Reynolds number.

The p-value of a number is the probability that it lies as far out on its side of the distribution that is predicted
for it, or on the other side. Each number is predicted from those before it, and from the priors: L_z from the velocity,
L_a from velocity and L_z, the flow rate from all of them. No number is used for its own prediction, so that the
p-values are uniform and independent if all is as stated (M. Rosenblatt, Ann. Math. Stat. 23 (1952) 470; with the prior
as part of the model: G. E. P. Box, J. R. Stat. Soc. A 143 (1980) 383). The velocity has none: the prior of the mean
velocity is flat, and nothing before it predicts it. Where the velocity was not measured, the flow rate takes its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.exact import ExactEngine
from capsbayes.infer.grid.posterior import ExactPosterior, GridPosterior
from capsbayes.infer.kernel import p_value, p_values_of_lengths
from capsbayes.measurement import Measurement
from capsbayes.parameters import PARAMETERS
from capsbayes.status import Status

PREDICTED = ("axial_extent", "axial_length", "flow_rate")
"""Quantities that have a p-value, where they were measured; each is predicted from those before it."""

LEVEL = 1e-3
"""P-value below which the measurement contradicts the model and the priors."""

LARGEST_REYNOLDS_NUMBER = 1.0
"""rho U l / mu at which the stress of inertia rho U^2 equals the viscous stress mu U / l."""

_DRAWS = 4000


class Misfit(NamedTuple):
    """A gate on the measurement and the status of a posterior that fails it."""

    gate: Gate
    status: Status


def p_values(engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior) -> dict[str, float]:
    """Return the p-values of what was measured, by name; of the lengths unless an outline takes their place."""
    found = {} if measurement.outline is not None else _of_lengths(engine, posterior.density)
    rate = posterior.density.flow_rate
    if rate is not None and not posterior.density.inputs.by_flow_rate:
        without = replace(posterior.density.inputs, flow_rate=None)
        mean, variance = _log_flow(engine(measurement, inputs=without))
        score = (rate.mean - mean) / np.sqrt(rate.variance + variance)
        found["flow_rate"] = p_value(np.ones(1), np.array([score]))
    return found


def _log_flow(posterior: ExactPosterior) -> tuple[float, float]:
    """Return mean and variance of the log of the flow rate: from the nodes if these tell all, else from draws."""
    area = posterior.density.inputs.area
    if not isinstance(posterior, GridPosterior) or posterior.cut or posterior.half_width is not None:
        draws = posterior.drawn(np.random.default_rng([0, 3]), _DRAWS)
        flow = np.log(draws["mean_velocity"] * draws["half_width"] ** 2 * area * posterior.forward.relative_area(draws))
        return float(flow.mean()), float(flow.var())
    weights, nodes, _ = posterior.kept
    theta = {"capillary_number": np.exp(nodes.log_ca), "size_ratio": nodes.size}
    of_flow, width = (posterior.distribution(name) for name in ("mean_velocity", "half_width"))
    log_area = np.log(area) + float(weights @ np.log(posterior.forward.relative_area(theta)))
    return of_flow.mean + 2.0 * width.mean + log_area, of_flow.variance + 4.0 * width.variance


def misfits_of(found: Mapping[str, float]) -> list[Misfit]:
    """Return the gates on p-values by name, first the one whose failure explains the others."""
    lengths = dict.fromkeys(PREDICTED, Status.LENGTHS_MISFIT) | {"flow_rate": Status.FLOW_CONFLICT}
    return [
        Misfit(Gate(f"predictive p-value of {PARAMETERS[name].symbol}", found[name], least=LEVEL), lengths[name])
        for name in reversed(PREDICTED)
        if np.isfinite(found.get(name, np.nan))
    ]


def inertia(reynolds_number: float) -> Misfit:
    """Return the gate on a Reynolds number."""
    return Misfit(Gate("Reynolds number", reynolds_number, most=LARGEST_REYNOLDS_NUMBER), Status.INERTIA)


def _of_lengths(engine: ExactEngine, density: PosteriorDensity) -> dict[str, float]:
    """Return the p-values of L_z and L_a."""
    model, logs = engine.predicted_shapes(density)
    width = density.inputs.half_width
    seen = density.likelihood.with_half_width(width.value, width.error)
    differences = np.broadcast_arrays(*seen.differences(model))
    found = p_values_of_lengths(np.exp(logs - logs.max()), *map(np.ascontiguousarray, differences))
    return {name: p for name, p in zip(PREDICTED, found, strict=False) if np.isfinite(p)}
