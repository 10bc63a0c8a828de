"""Slopes of G_s and a by each input: differences of the exact engine's medians.

A step is half a standard error of the input, so that the slope is that over
the range that matters; of an input that is known, half a percent. Where one of
the two steps makes a shape that cannot be, a length on the axis beyond the
extent or a shape far from all of the model, the other alone is taken. An input
that the shape does not depend on moves no grid: the same posterior is read
with another factor.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from capsbayes.errors import InputError
from capsbayes.infer.exact import ExactEngine, engine_near
from capsbayes.infer.grid.posterior import ExactPosterior, GridPosterior
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.shares import QUANTITIES
from capsbayes.measurement import Measurement

STEP = 0.5  # standard errors
STEP_OF_KNOWN = 5e-3  # of the value

_Case = tuple[Measurement, Inputs]


@dataclass(frozen=True)
class Setting:
    """Value and standard error of one input."""

    name: str  # as in `capsbayes.parameters`
    value: float
    error: float
    unit: str  # SI, or "l" for lengths over the half width

    @property
    def step(self) -> float:
        """Step to either side."""
        return STEP * self.error if self.error > 0.0 else STEP_OF_KNOWN * self.value


def settings_of(measurement: Measurement, inputs: Inputs) -> dict[str, Setting]:
    """Return the numeric inputs of a measurement; an outline replaces the lengths."""
    known = {"viscosity": (inputs.viscosity, "Pa s"), "capsule_velocity": (inputs.capsule_velocity, "m/s")}
    if inputs.flow_rate is not None and inputs.by_flow_rate:
        del known["capsule_velocity"]
        known["flow_rate"] = inputs.flow_rate, "m^3/s"
    known["half_width"] = (inputs.half_width, "m")
    found = {name: Setting(name, quantity.value, quantity.error, unit) for name, (quantity, unit) in known.items()}
    unit = "l" if measurement.over_half_width else "m"
    if measurement.outline is None:
        pair = measurement.axial_extent, measurement.axial_extent_error
        found["axial_extent"] = Setting("axial_extent", *pair, unit)
    if measurement.outline is None or measurement.length_with_outline is not None:
        length, error = measurement.axial_length, measurement.axial_length_error
        if length is not None and error is not None:
            found["axial_length"] = Setting("axial_length", length, error, unit)
    return found


def log_slopes(
    engine: ExactEngine, measurement: Measurement, posterior: ExactPosterior, setting: Setting
) -> dict[str, float]:
    """Compute d ln(quantity) / d ln(input) of the posterior medians of G_s and a; NaN where no step can be made."""
    ends = {}
    for sign in (-1.0, 1.0):
        value = setting.value + sign * setting.step
        with contextlib.suppress(InputError):
            moved = _MOVES[setting.name](measurement, posterior.density.inputs, value)
            ends[value] = _log_medians(_again(engine, posterior, measurement, *moved))
    if len(ends) == 1:
        ends[setting.value] = _log_medians(posterior)
    if not ends:
        return dict.fromkeys(QUANTITIES, float("nan"))
    low, high = min(ends), max(ends)
    width = float(np.log(high / low))
    return {name: (ends[high][name] - ends[low][name]) / width for name in QUANTITIES}


def _again(
    engine: ExactEngine, before: ExactPosterior, seen: Measurement, moved: Measurement, inputs: Inputs
) -> ExactPosterior:
    """Return the posterior of a moved measurement or of moved inputs, from that before."""
    same_width = inputs.half_width is before.density.inputs.half_width
    same_shape = moved is seen and (same_width or before.density.likelihood.over_half_width)
    if same_shape and isinstance(before, GridPosterior) and not before.cut:
        return replace(before, density=replace(before.density, inputs=inputs))
    return engine_near(engine, before)(moved, inputs=inputs)


def _log_medians(posterior: ExactPosterior) -> dict[str, float]:
    return {name: posterior.log_marginal(name).median for name in QUANTITIES}


def _of_input(name: str) -> Callable[[Measurement, Inputs, float], _Case]:
    def move(measurement: Measurement, inputs: Inputs, value: float) -> _Case:
        return measurement, replace(inputs, **{name: getattr(inputs, name).rescaled(value)})

    return move


_MOVES: Mapping[str, Callable[[Measurement, Inputs, float], _Case]] = {
    "viscosity": _of_input("viscosity"),
    "capsule_velocity": _of_input("capsule_velocity"),
    "flow_rate": _of_input("flow_rate"),
    "half_width": _of_input("half_width"),
    "axial_extent": lambda measurement, inputs, value: (replace(measurement, axial_extent=value), inputs),
    "axial_length": lambda measurement, inputs, value: (replace(measurement, axial_length=value), inputs),
}
