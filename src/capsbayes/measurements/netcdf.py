"""A set as one NetCDF file: outlines of all capsules with their lengths, velocities and noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import check_file, parsing
from capsbayes.files.output_file import write_dataset
from capsbayes.measured_outline import MID_PLANE, MeasuredOutline, OutlineNoise, Pose, check_view
from capsbayes.measurement import CONDITIONS, Measurement
from capsbayes.measurements.measured_set import MeasuredSet, gathered, known_experiment
from capsbayes.parameters import PARAMETERS

# numbers over the capsules
_NEEDED = ("axial_extent", "axial_extent_error")
_VELOCITY = ("capsule_velocity", "capsule_velocity_error")
_LENGTH = ("axial_length", "axial_length_error")
_RATE = ("flow_rate", "flow_rate_error")
_NOISE = {"noise_scale": "l", "noise_correlation": "l", "noise_white": "1"}
_UNITS = {
    name: PARAMETERS[name.removesuffix("_error")].unit for name in (*_NEEDED, *_VELOCITY, *_LENGTH, *_RATE, *CONDITIONS)
}
_OUTLINE = ("capsule", "point", "axis")


def read_netcdf(path: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a file of outlines.

    Parameters
    ----------
    path : Path
        With the variables ``outline`` (capsule, point, axis) [l], columns (z, y), filled up with NaN behind a short
        one; over the capsules ``axial_extent``, ``axial_extent_error`` [l], ``capsule_velocity``,
        ``capsule_velocity_error`` [m/s] or ``flow_rate`` and ``flow_rate_error`` [m^3/s] or all four, ``noise_scale``,
        ``noise_correlation`` [l] as of `OutlineNoise`; optionally ``noise_white``, ``axial_length``,
        ``axial_length_error`` [l], ``half_width`` [m] and ``viscosity`` [Pa s] where they are not those of the
        experiment (else NaN), and ``name``. A variable's attribute ``units``, if it has one, must be the unit here.
        The attribute ``view`` says what all outlines show, ``"mid-plane"`` by default.
    experiment : Experiment or path
        By default the file that the attribute ``experiment`` names, relative to this one.

    Raises
    ------
    InputError
        On a variable that is missing or of another shape or unit, or if no capsule can be used.
    """
    dataset = opened(path)
    named = dataset.attrs.get("experiment")
    known = known_experiment(path, path.parent / str(named) if experiment is None and named else experiment)
    _check(path, dataset)
    readers = [partial(_measurement, path, dataset, row) for row in range(dataset.sizes["capsule"])]
    measurements, left_out = gathered(readers, path)
    return MeasuredSet(measurements, known, left_out)


def write_netcdf(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write a file that `read_netcdf` reads.

    Raises
    ------
    InputError
        If a capsule has no outline, or one with another `Pose` than the usual, or if they differ in their view.
    """
    outlines = [seen.outline for seen in measurements if seen.outline is not None]
    if len(outlines) < len(measurements):
        raise InputError(str(path), "outline", "capsules with outlines", "one without", "write a folder or a .csv")
    if any(outline.pose != Pose() for outline in outlines):
        advice = "write a folder"
        raise InputError(str(path), "outline.pose", "outlines of the usual pose", "one of another", advice)
    views = sorted({outline.view for outline in outlines})
    if len(views) > 1:
        raise InputError(str(path), "outline.view", "outlines of one view", ", ".join(views), "write a folder")
    points = np.full((len(outlines), max(len(outline.points) for outline in outlines), 2), np.nan)
    for row, outline in enumerate(outlines):
        points[row, : len(outline.points)] = outline.points
    noises = [outline.noise for outline in outlines]
    noise = np.array([[noise.scale, noise.correlation_length, noise.white] for noise in noises])
    numbers = {name: [getattr(seen, name) for seen in measurements] for name in (*_NEEDED, *_VELOCITY, *_LENGTH)}
    numbers |= dict(zip(_NOISE, noise.T, strict=True))
    own = {name: [seen.conditions.get(name, np.nan) for seen in measurements] for name in CONDITIONS}
    own |= {name: [getattr(seen, name) or np.nan for seen in measurements] for name in _RATE}
    numbers |= {name: values for name, values in own.items() if np.isfinite(values).any()}
    units = _UNITS | _NOISE
    variables = {name: ("capsule", np.array(values, float), {"units": units[name]}) for name, values in numbers.items()}
    dataset = xr.Dataset({**variables, "outline": (_OUTLINE, points, {"units": "l"})}, coords={"axis": ["z", "y"]})
    dataset.attrs["view"] = (views or [MID_PLANE])[0]
    write_dataset(path, dataset)


def opened(path: Path) -> xr.Dataset:
    """Return the content of a NetCDF file.

    Raises
    ------
    InputError
        If it is none, or damaged.
    """
    check_file(path, "NetCDF file")
    with parsing(str(path), "a NetCDF file"), xr.open_dataset(path, engine="h5netcdf") as opened:
        return opened.load()


def _check(path: Path, dataset: xr.Dataset) -> None:
    """Refuse a file that lacks a variable, or has one of another shape or unit."""
    velocity = () if "flow_rate" in dataset.variables else _VELOCITY
    needed = ("outline", *_NEEDED, *velocity, "noise_scale", "noise_correlation")
    for name, unit in {"outline": "l", **_UNITS, **_NOISE}.items():
        dims = _OUTLINE if name == "outline" else ("capsule",)
        wanted = f"a variable ({', '.join(dims)}) in {unit}"
        if name not in dataset.variables:
            if name in needed:
                raise InputError(str(path), name, wanted, "nothing", "add the missing variable")
            continue
        found = dataset[name]
        if found.dims != dims or found.dtype.kind not in "fiu" or (name == "outline" and found.shape[2] != 2):
            sizes = ", ".join(f"{dim}: {size}" for dim, size in found.sizes.items())
            raise InputError(str(path), name, wanted, f"one of {found.dtype} ({sizes})")
        if str(found.attrs.get("units", unit)) != unit:
            raise InputError(str(path), name, wanted, f"one in {found.attrs['units']}", "convert it")


def _measurement(path: Path, dataset: xr.Dataset, row: int) -> Measurement:
    capsule = dataset.isel(capsule=row)
    label = str(capsule["name"].item()) if "name" in capsule.variables else str(row + 1)
    where = f"{path}: capsule {label}"
    names = (*_NEEDED, *_VELOCITY, *_LENGTH, *_RATE)
    numbers = {name: float(capsule[name]) for name in names if name in capsule.variables}
    needed = _NEEDED if np.isfinite(numbers.get("flow_rate", np.nan)) else (*_NEEDED, *_VELOCITY)
    seen = {name: value for name, value in numbers.items() if name in needed or np.isfinite(value)}
    points = np.asarray(capsule["outline"].values, np.float64)
    view = check_view(capsule.attrs.get("view", MID_PLANE), str(path), "view")
    white = float(capsule["noise_white"]) if "noise_white" in capsule.variables else 0.0
    try:
        noise = OutlineNoise(float(capsule["noise_scale"]), float(capsule["noise_correlation"]), white)
        outline = MeasuredOutline(points[np.isfinite(points).any(axis=1)], noise, view=view)
    except InputError as error:  # which does not know whose outline it is
        raise InputError(where, error.key, error.expected, error.got, error.advice) from None
    own = {
        name: float(capsule[name]) for name in CONDITIONS if name in capsule.variables and np.isfinite(capsule[name])
    }
    return Measurement(**seen, outline=outline, conditions=own, source=where)  # type: ignore[arg-type]
