"""Checks of a posterior against the measurement that it was computed from: predictive p-values, Reynolds number.

A posterior predictive p-value is the probability that a repeated measurement would lie as far from its prediction as
the one made, on the same side or on the other (Gelman, Meng, Stern 1996, Statistica Sinica 6, 733). It tells whether
any shape that the priors allow explains a number. The number itself has been used, so that two lengths, which fix two
parameters, fail only where a prior or the border of the model holds the shape elsewhere: false alarms are rarer
than the level. The flow rate is predicted without itself, from the velocity of the capsule and its shape; its
p-value is uniform if all is as stated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.checks import Gate
from capsbayes.infer.grid.mixed import ExactEngine
from capsbayes.infer.grid.posterior import ExactPosterior
from capsbayes.infer.kernel import p_value
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.measurement import Measurement
from capsbayes.parameters import PARAMETERS
from capsbayes.status import Status

LEVELS = {"axial_extent": 1e-2, "axial_length": 1e-2, "capsule_velocity": 1e-2, "flow_rate": 1e-3}
"""P-values below which the measurement and the posterior contradict each other, by what was measured."""

PREDICTED = tuple(LEVELS)
"""Quantities that have a p-value, where they were measured."""

LARGEST_REYNOLDS_NUMBER = 1.0
"""rho U l / mu at which the stress of inertia rho U^2 equals the viscous stress mu U / l."""

_DRAWS = 4000


class Misfit(NamedTuple):
    """A gate on the measurement and the status of a posterior that fails it."""

    gate: Gate
    status: Status


def p_values(engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior) -> dict[str, float]:
    """Return the p-values of what was measured, by name; of the lengths unless an outline takes their place."""
    draws = posterior.drawn(np.random.default_rng([0, 3]), _DRAWS)
    found = {} if measurement.outline is not None else _of_lengths(measurement, posterior, draws)
    off = (measurement.capsule_velocity - draws["capsule_velocity"]) / measurement.capsule_velocity_error
    found["capsule_velocity"] = p_value(np.ones(_DRAWS), off)
    rate = posterior.density.flow_rate
    if rate is not None:
        draws = engine(replace(measurement, flow_rate=None)).drawn(np.random.default_rng([0, 3]), _DRAWS)
        area = posterior.density.inputs.area * posterior.forward.relative_area(draws)
        flow = np.log(draws["mean_velocity"] * draws["half_width"] ** 2 * area)
        score = (rate.mean - flow.mean()) / np.sqrt(rate.variance + flow.var())
        found["flow_rate"] = p_value(np.ones(1), np.array([score]))
    return found


def misfits_of(found: Mapping[str, float]) -> list[Misfit]:
    """Return the gates on p-values by name, first the one whose failure explains the others."""
    lengths = dict.fromkeys(PREDICTED, Status.LENGTHS_MISFIT) | {"flow_rate": Status.FLOW_CONFLICT}
    return [
        Misfit(Gate(f"predictive p-value of {PARAMETERS[name].symbol}", found[name], least=LEVELS[name]), lengths[name])
        for name in reversed(PREDICTED)
        if np.isfinite(found.get(name, np.nan))
    ]


def inertia(reynolds_number: float) -> Misfit:
    """Return the gate on a Reynolds number."""
    return Misfit(Gate("Reynolds number", reynolds_number, most=LARGEST_REYNOLDS_NUMBER), Status.INERTIA)


def _of_lengths(measurement: Measurement, posterior: ExactPosterior, draws: Mapping[str, Floats]) -> dict[str, float]:
    names = ("capillary_number", "size_ratio", *posterior.forward.coordinates)
    model = ModelAtPoints.of(posterior.forward({name: draws[name] for name in names}))
    scale = 1.0 if measurement.over_half_width else draws["half_width"]
    seen = zip(PREDICTED, measurement.lengths, measurement.covariance.diagonal(), strict=False)
    predicted: Sequence[tuple[Floats, Floats]] = [(model.extent, model.zz), (model.length, model.aa)]
    return {
        name: p_value(np.ones(_DRAWS), (value / scale - mean) / np.sqrt(variance / scale**2 + own))
        for (name, value, variance), (mean, own) in zip(seen, predicted, strict=False)
    }
