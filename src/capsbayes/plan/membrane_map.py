"""Map of what one capsule tells of its shear modulus with the membrane unknown, next to that with it known.

Each point is the posterior of a measurement without noise, by the engine that identifies single capsules.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, imposed_velocity
from capsbayes.infer.exact import ExactEngine, exact_engine
from capsbayes.infer.many.one_membrane.identify_membrane import unknowns_of
from capsbayes.infer.membrane import Membrane
from capsbayes.infer.prior import Prior
from capsbayes.measurement import Measurement
from capsbayes.membrane_database import lowest_ca
from capsbayes.model import ForwardModel
from capsbayes.plan.borders import range_at
from capsbayes.plan.expectation import Expectation
from capsbayes.plan.flow import flow_rate
from capsbayes.plan.identifiability import Progress, lab_attributes
from capsbayes.plan.lab_errors import LabErrors
from capsbayes.plan.membrane_flow import check_lengths, expected_scores, membrane_at
from capsbayes.plan.planned_batch import EVERY
from capsbayes.surrogate import MembraneSurrogate
from capsbayes.work import step_of

if TYPE_CHECKING:
    import xarray as xr

GRID = (10, 6)
"""Points along log Ca and along a/l."""

MEASURED = {"lengths": "lengths", "outline": "outlines"}
"""What is measured, as variables of the map end, in words."""

UNKNOWN, KNOWN = "unknown", "known"
"""Of the membrane, as variables of the map begin."""

_MODULUS = 0.05  # N/m; the map does not depend on it
_WITHIN = 1e-9  # margin that keeps the ends of the grid inside the domain despite rounding


def membrane_map(
    experiment: Experiment,
    errors: LabErrors,
    *,
    model: MembraneSurrogate | None = None,
    membrane: Membrane | None = None,
    guess: Membrane | None = None,
    prior: Prior | None = None,
    grid: tuple[int, int] = GRID,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the standard deviation of ln G_s from one capsule, over the plane (Ca, a/l)."""
    # Variables ``unknown_lengths`` and ``known_lengths``, with the membrane unknown and known, and ``unknown_outline``
    # and ``known_outline`` where outlines have errors, NaN where the model has no shape; over a/l ``lowest`` and
    # ``highest``, the borders in Ca of the membrane that is expected. The attributes hold that membrane, model, errors,
    # version.
    if min(grid) < 2:
        raise InputError("membrane_map", "grid", "two points along each axis", repr(grid))
    check_lengths(errors, "membrane_map")
    model = model or MembraneSurrogate.open(experiment.cross_section, view=errors.view)
    model.check_experiment(experiment)
    unknowns = unknowns_of(model, membrane or Membrane(), prior or Prior(), experiment, (None, None))
    scores = expected_scores(unknowns, guess, model)
    expected = membrane_at(unknowns, scores, Expectation.of(_MODULUS, model_middle(model, experiment), experiment))
    fixed = model.fixed(**expected)
    (low, high), sizes = model.domain.bounds
    lowest = max(low, float(lowest_ca(expected["pre_inflation"])))
    ca, size = np.geomspace(lowest, (1.0 - _WITHIN) * high, grid[0]), np.linspace(*sizes, grid[1])
    inside = np.stack([fixed.domain.contains(ca, np.full(len(ca), ratio)) for ratio in size])
    applied, believed = (membrane or Membrane()).applied(model, prior or Prior())
    engines = {
        UNKNOWN: exact_engine(applied, experiment, believed),
        KNOWN: exact_engine(fixed, replace(experiment, membrane_thickness=None)),
    }
    kinds = ("lengths", "outline") if errors.outline is not None else ("lengths",)
    found = {f"{known}_{kind}": np.full(inside.shape, np.nan) for kind in kinds for known in engines}
    points = list(zip(*np.nonzero(inside), strict=True))
    with threadpool_limits(limits=1):
        for row, column in points if progress is None else progress(points, len(points), "points of the map"):
            seen = _measured(fixed, float(ca[column]), float(size[row]), errors, experiment)
            for name, values in found.items():
                known, kind = name.split("_")
                values[row, column] = _log_modulus_sd(engines[known], seen[kind])
    ranges = [range_at(fixed, float(ratio)) for ratio in size]
    borders = {end: np.array([getattr(one, end) for one in ranges]) for end in ("lowest", "highest")}
    attributes = lab_attributes(model, experiment, errors) | {"membrane": json.dumps(expected)}
    return _dataset(ca, size, found, borders, attributes)


def model_middle(model: MembraneSurrogate, experiment: Experiment) -> float:
    """Return the radius in the middle of those that a model has [m]."""
    return float(np.mean(model.domain.bounds[1])) * experiment.half_width.value


def _measured(
    model: ForwardModel, ca: float, size: float, errors: LabErrors, experiment: Experiment
) -> dict[str, Measurement]:
    """Return what is measured of a capsule without noise: its lengths alone, and its outline too."""
    there = model.at(capillary_number=ca, size_ratio=size, outline=True)
    assert there.outline is not None, "asked for"
    viscosity = experiment.viscosity.value
    speed = float(imposed_velocity(viscosity=viscosity, capillary_number=ca, surface_shear_modulus=_MODULUS))
    rate = flow_rate(speed, experiment.half_width.value, experiment.cross_section)
    velocity, lengths = speed * float(there.velocity_ratio[0]), there.values[0, :2]
    outline = there.outline[0, ::EVERY]
    return {
        "lengths": errors.measured(lengths, velocity, flow_rate=rate),
        "outline": errors.measured(lengths, velocity, outline, rate),
    }


class _Width(NamedTuple):
    sd: float


def _log_modulus_sd(engine: ExactEngine, seen: Measurement) -> float:
    """Return the standard deviation of ln G_s; NaN where the measurement has no posterior."""

    def compute() -> _Width:
        with contextlib.suppress(InputError):
            return _Width(engine(seen).log_marginal("surface_shear_modulus").sd)
        return _Width(np.nan)

    return step_of(_Width, ("membrane map", engine.model.sha256, engine.prior, engine.experiment, seen), compute).sd


def _dataset(
    ca: Floats, size: Floats, found: dict[str, Floats], borders: dict[str, Floats], attributes: dict[str, str]
) -> xr.Dataset:
    import xarray as xr

    variables: dict[str, Any] = {}
    for name, values in found.items():
        known, kind = name.split("_")
        words = f"standard deviation of ln G_s by {MEASURED[kind]}, membrane {known}"
        variables[name] = (("size_ratio", "capillary_number"), values, {"units": "-", "long_name": words})
    for end, values in borders.items():
        variables[end] = ("size_ratio", values, {"units": "-", "long_name": f"{end} Ca"})
    places = {
        "capillary_number": ("capillary_number", ca, {"units": "-", "long_name": "Ca, mu U / G_s"}),
        "size_ratio": ("size_ratio", size, {"units": "-", "long_name": "a/l"}),
    }
    return xr.Dataset(variables, places, attributes)
