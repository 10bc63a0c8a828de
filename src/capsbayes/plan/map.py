"""Expected widths over Ca and a/l, and tables of them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import KDTree
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, capsule_radius, mean_velocity, surface_shear_modulus
from capsbayes.infer.grid import ExactPosterior, GridPosterior
from capsbayes.infer.identify import QUANTITIES
from capsbayes.infer.importance import ExactEngine, engine_near
from capsbayes.infer.prior import Inputs
from capsbayes.measurement import Measurement
from capsbayes.model import TWO_SHAPES, ForwardModel
from capsbayes.plan.lab import Borders, LabErrors, range_at
from capsbayes.plan.widths import NOISES, Width, WidthPredictor

if TYPE_CHECKING:
    import xarray as xr


# Identifiability map: expected widths of the posterior of G_s and a over the plane (Ca, a/l)

Progress = Callable[[Iterable, int, str], Iterable]
"""Wrapper of the points that are computed, given their number and a title, to show progress."""

GRID = (28, 20)
"""Points along log Ca and along a/l."""

_WITHIN = 1e-9  # margin that keeps the ends of the grid inside the domain despite rounding

_MEANINGS = {
    "relative": ("width_of_surface_shear_modulus", "half of the 68 % interval of G_s over its median, mean over noise"),
    "sd": ("sd_of_log_surface_shear_modulus", "standard deviation of log G_s, mean over noise"),
    "relative_radius": ("width_of_capsule_radius", "half of the 68 % interval of a over its median, mean over noise"),
    "noise_free": ("noise_free_width", "half of the 68 % interval of G_s over its median, measured without noise"),
    "leaning": ("leaning", "share of the posterior next to the border of the model, measured without noise"),
}


@checked
def identifiability_map(
    model: ForwardModel,
    experiment: Experiment,
    errors: LabErrors,
    *,
    grid: tuple[int, int] = GRID,
    noises: int = NOISES,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Compute the relative widths that a lab would get, over the plane (Ca, a/l).

    Parameters
    ----------
    model : ForwardModel
    experiment : Experiment
        Channel and liquid, with their errors.
    errors : LabErrors
        Of the lengths and of the velocity.
    grid : tuple of int
        Points along log Ca and along a/l, from end to end of the model.
    noises : int
        Measurements that each width is averaged over; zero for the noise-free measurement alone.
    progress : callable, optional
        Wraps the iterable of computed points to show progress, see `Progress`.

    Returns
    -------
    Dataset
        Over ``size_ratio`` and ``capillary_number``; NaN where the model has no shape. Variables:
        ``width_of_surface_shear_modulus``, ``sd_of_log_surface_shear_modulus``, ``width_of_capsule_radius``,
        ``noise_free_width``, ``leaning``, ``two_shapes`` and, over a/l, ``lowest`` and ``highest``, the borders in Ca.
        The attributes hold model, fingerprint, errors, version.

    Raises
    ------
    InputError
        If the grid or the model cannot be used.
    """
    if min(grid) < 2 or noises < 0:
        raise InputError(
            "identifiability_map", "grid, noises", "two points along each axis, no fewer than 0", repr(grid)
        )
    predictor = WidthPredictor(model, experiment, errors, noises=noises)
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    ends = (1.0 + _WITHIN) * ca_low, (1.0 - _WITHIN) * ca_high
    ca, size = np.geomspace(*ends, grid[0]), np.linspace(size_low, size_high, grid[1])
    inside = np.stack([model.domain.contains(ca, np.full(len(ca), ratio)) for ratio in size])
    points = list(zip(*np.nonzero(inside), strict=True))
    values = {name: np.full(inside.shape, np.nan) for name in Width.names()}
    with threadpool_limits(limits=1):
        for row, column in _shown(points, progress, "points of the map"):
            width = predictor.at(float(ca[column]), float(size[row]))
            for name, array in values.items():
                array[row, column] = getattr(width, name)
    return _dataset(model, ca, size, inside, values, lab_attributes(model, experiment, errors) | {"noises": noises})


def lab_attributes(model: ForwardModel, experiment: Experiment, errors: LabErrors) -> dict[str, str]:
    """Return model, experiment and errors as attributes of a file."""
    known = {"half_width": experiment.half_width, "viscosity": experiment.viscosity}
    lab = {
        name: {"value": quantity.mean, "error": quantity.sd, "unit": quantity.unit} for name, quantity in known.items()
    }
    return {
        "model": model.name,
        "model_sha256": model.sha256,
        "cross_section": experiment.cross_section,
        "experiment": json.dumps(lab),
        "errors": json.dumps(errors.as_dict()),
        "version": __version__,
    }


def _shown(points: list, progress: Progress | None, what: str) -> Iterator:
    yield from points if progress is None else progress(points, len(points), what)


def _dataset(
    model: ForwardModel,
    ca: Floats,
    size: Floats,
    inside: Booleans,
    values: dict[str, Floats],
    attributes: dict[str, str | int],
) -> xr.Dataset:
    import xarray as xr

    plane = ("size_ratio", "capillary_number")
    found: dict[str, Any] = {
        name: (plane, values[field], {"units": "-", "long_name": meaning})
        for field, (name, meaning) in _MEANINGS.items()
    }
    ranges = [range_at(model, float(ratio)) for ratio in size]
    found |= {
        end: (
            "size_ratio",
            np.array([getattr(limits, end) for limits in ranges]),
            {"units": "-", "long_name": f"{end} Ca"},
        )
        for end in ("lowest", "highest")
    }
    two = np.zeros(inside.shape, dtype=np.int8)
    row, column = np.nonzero(inside)
    caveats = model.caveats({"capillary_number": ca[column], "size_ratio": size[row]})
    two[row, column] = caveats.get(TWO_SHAPES, np.zeros(len(row), dtype=bool))
    found["two_shapes"] = (plane, two, {"units": "-", "long_name": "1 where two steady shapes are stable"})
    places = {
        "capillary_number": ("capillary_number", ca, {"units": "-", "long_name": "Ca, mu U / G_s"}),
        "size_ratio": ("size_ratio", size, {"units": "-", "long_name": "a/l"}),
    }
    return xr.Dataset(found, places, attributes)


# Slopes of G_s and a by each input: differences of the exact engine's medians.
#
# A step is half a standard error of the input, so that the slope is that over
# the range that matters; of an input that is known, half a percent. Where one of
# the two steps makes a shape that cannot be, a length on the axis beyond the
# extent or a shape far from all of the model, the other alone is taken. An input
# that the shape does not depend on moves no grid: the same posterior is read
# with another factor

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


# The paper's deterministic answer for many samples of the inputs, with the nearest shape where there is none

ANSWERS = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio")
"""Quantities answered, as in `capsbayes.parameters`."""

_LATTICE = (400, 240)  # of the shapes among which the nearest is sought, along log Ca and a/l


@dataclass(frozen=True, eq=False)
class NearestShape:
    """Lattice of the shapes of a model, to find the nearest to two lengths."""

    places: Floats  # (n, 3): columns Ca, a/l and v_o/U
    tree: KDTree  # of the lengths over their scales
    scales: Floats  # (2,) [l]

    @classmethod
    def of(cls, model: ForwardModel, scales: Floats) -> NearestShape:
        """Lay a lattice over the domain of a model."""
        (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
        ca, size = np.geomspace(ca_low, ca_high, _LATTICE[0]), np.linspace(size_low, size_high, _LATTICE[1])
        there = model({"capillary_number": np.repeat(ca, len(size)), "size_ratio": np.tile(size, len(ca))})
        kept = there.inside
        places = np.stack([np.repeat(ca, len(size)), np.tile(size, len(ca)), there.velocity_ratio], axis=1)[kept]
        return cls(places, KDTree(there.values[kept, :2] / scales), scales)

    def __call__(self, lengths: Floats) -> Floats:
        """Return Ca, a/l and v_o/U of the nearest shape : (n, 2) -> (n, 3) array."""
        return self.places[np.asarray(self.tree.query(lengths / self.scales)[1])]


@dataclass(frozen=True, eq=False)
class Answerer:
    """Deterministic answer as a function of all inputs."""

    model: ForwardModel  # with a database
    inputs: Inputs
    centre: Mapping[str, float]  # value of each input that a sample does not state
    over_half_width: bool  # whether the lengths are over l or in metres
    nearest: NearestShape  # for lengths that no capsule of the database has

    @classmethod
    def of(cls, model: ForwardModel, measurement: Measurement, inputs: Inputs, sds: Mapping[str, float]) -> Answerer:
        """Set up the function for the inputs of one capsule; refuse a model without a database or with a coordinate."""
        # In units of the standard deviations of the lengths, over which they vary, shapes are near or far.
        if model.database is None or model.coordinates:
            raise InputError("sobol", "model", "a database of (Ca, a/l), as the paper's procedure needs", model.name)
        speed = "flow_rate" if inputs.by_flow_rate else "capsule_velocity"
        centre = {name: getattr(inputs, name).value for name in ("viscosity", "half_width", speed)}
        lengths = {name: float(getattr(measurement, name)) for name in ("axial_extent", "axial_length")}
        scale = 1.0 if measurement.over_half_width else centre["half_width"]
        relative = 0.0 if measurement.over_half_width else sds.get("half_width", 0.0) / centre["half_width"]
        own = [np.hypot(sds.get(name, 0.0), relative * length) / scale for name, length in lengths.items()]
        scales = np.maximum(own, 0.1 * max(*own, 1e-6))
        return cls(model, inputs, centre | lengths, measurement.over_half_width, NearestShape.of(model, scales))

    def __call__(self, samples: Mapping[str, Floats]) -> tuple[dict[str, Floats], Booleans]:
        """Return the answers by name [SI] to all samples (n,), and whether each is that of the nearest shape."""
        count = len(next(iter(samples.values())))
        all_inputs = {name: samples.get(name, np.full(count, value)) for name, value in self.centre.items()}
        scale = 1.0 if self.over_half_width else all_inputs["half_width"]
        lengths = np.stack([all_inputs["axial_extent"], all_inputs["axial_length"]], axis=1)
        lengths = lengths / np.reshape(scale, (-1, 1))
        unique, which = np.unique(lengths, axis=0, return_inverse=True)
        places, outside = self._places(unique)
        ca, size, ratio = places[which.ravel()].T
        if self.inputs.by_flow_rate:
            flow = all_inputs["flow_rate"] / (self.inputs.area * all_inputs["half_width"] ** 2)
        else:
            flow = mean_velocity(capsule_velocity=all_inputs["capsule_velocity"], velocity_ratio=ratio)
        modulus = surface_shear_modulus(viscosity=all_inputs["viscosity"], mean_velocity=flow, capillary_number=ca)
        radius = capsule_radius(size_ratio=size, half_width=all_inputs["half_width"])
        return dict(zip(ANSWERS, (modulus, radius, ca, size), strict=True)), outside[which.ravel()]

    def _places(self, lengths: Floats) -> tuple[Floats, Booleans]:
        """Return Ca, a/l and v_o/U (n, 3) of lengths (n, 2), and a mask of the answers of the nearest shape."""
        from capsbayes.surrogate import inverse

        assert self.model.database is not None
        procedure = inverse(self.model.database)
        places = np.full((len(lengths), 3), np.nan)
        for row in np.flatnonzero((lengths[:, 1] > 0.0) & (lengths[:, 1] <= lengths[:, 0])):
            found = procedure(axial_extent=float(lengths[row, 0]), axial_length=float(lengths[row, 1]))
            places[row] = found.capillary_number, found.size_ratio, found.velocity_ratio
        outside = ~self.model.domain.contains(places[:, 0], places[:, 1])
        places[outside] = self.nearest(lengths[outside])
        return places, outside


# Table of expected widths over Ca and a/l, for many capsules at once

_POINTS = 32  # along log Ca in each column
_SPACING, _MOST = 0.015, 9  # of the columns, and how many
_TAIL = 0.002  # of the sizes beyond either end of the columns
_BORDERS = 65


@dataclass(frozen=True, eq=False)
class WidthTable:
    """Table of widths: Ca along columns of constant a/l."""

    columns: Floats  # (k,): a/l, rising
    log_ca: Floats  # (k, m): points of each column, from end to end of the model there
    values: dict[str, Floats]  # (k, m): the fields of `Width`
    borders: Borders

    @classmethod
    def of(cls, predictor: WidthPredictor, sizes: Floats, progress: Progress | None = None) -> WidthTable:
        """Compute the table for capsules of given sizes (n,), within the model."""
        model = predictor.model
        columns = _columns(model, sizes)
        ca = np.stack([range_at(model, float(size)).inner(_POINTS) for size in columns])
        places = [(row, column) for row in range(len(columns)) for column in range(_POINTS)]
        shown = places if progress is None else progress(places, len(places), "expected widths")
        values = {name: np.full(ca.shape, np.nan) for name in Width.names()}
        for row, column in shown:
            width = predictor.at(float(ca[row, column]), float(columns[row]))
            for field in fields(width):
                values[field.name][row, column] = getattr(width, field.name)
        return cls(columns, np.log(ca), values, _borders(model, columns))

    def at(self, ca: Floats, size: Floats) -> dict[str, Floats]:
        """Interpolate the widths of capsules linearly in log Ca and a/l : (n,) arrays by name."""
        size = np.clip(size, self.columns[0], self.columns[-1])
        right = np.clip(np.searchsorted(self.columns, size), 1, max(len(self.columns) - 1, 1))
        left = right - 1
        if len(self.columns) == 1:
            left = right = np.zeros(len(size), dtype=np.intp)
        gap = self.columns[right] - self.columns[left]
        share = np.where(gap > 0.0, (size - self.columns[left]) / np.where(gap > 0.0, gap, 1.0), 0.0)
        found = {}
        for name, values in self.values.items():
            by_column = np.stack([_along(np.log(ca), *pair) for pair in zip(self.log_ca, values, strict=True)])
            each = np.arange(len(size))
            found[name] = (1.0 - share) * by_column[left, each] + share * by_column[right, each]
        return found

    def highest(self, size: Floats) -> Floats:
        """Return the highest Ca of the model at sizes : (n,) array."""
        return self.borders.at(size)[1]


def _along(log_ca: Floats, places: Floats, values: Floats) -> Floats:
    known = np.isfinite(values)
    return np.interp(log_ca, places[known], values[known])


def _columns(model: ForwardModel, sizes: Floats) -> Floats:
    """Return columns over the sizes within the model : (k,) array; one if all are of one size."""
    first, last = model.domain.bounds[1]
    low, high = np.clip(np.quantile(sizes, [_TAIL, 1.0 - _TAIL]), first, last)
    if high - low < 1e-9:
        return np.array([low])
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) / _SPACING) + 1, 2, _MOST)))


def _borders(model: ForwardModel, columns: Floats) -> Borders:
    return Borders.of(model, columns if len(columns) == 1 else np.linspace(columns[0], columns[-1], _BORDERS))
