"""Expected widths over Ca and a/l."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.model import TWO_SHAPES, ForwardModel
from capsbayes.plan.lab import Borders, LabErrors, lab_attributes
from capsbayes.plan.widths import NOISES, Width, WidthPredictor, check_model

if TYPE_CHECKING:
    import xarray as xr

Progress = Callable[[Iterable, int, str], Iterable]
"""Wrapper of the points that are computed, given their number and a title, to show progress."""

GRID = (28, 20)
"""Points along log Ca and along a/l."""

WITHIN = 1e-9
"""Margin that keeps the ends of a grid inside the domain despite rounding."""

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
        expected = "two points along each axis, no fewer than 0"
        raise InputError("identifiability_map", "grid, noises", expected, repr(grid))
    check_model(model, experiment)
    predictor = WidthPredictor(model, experiment, errors, noises=noises)
    (ca_low, ca_high), sizes = model.domain.bounds
    ca, size = np.geomspace((1.0 + WITHIN) * ca_low, (1.0 - WITHIN) * ca_high, grid[0]), np.linspace(*sizes, grid[1])
    values, inside = over_plane(
        model, ca, size, Width.names(), lambda *place: asdict(predictor.at(*place)), progress=progress
    )
    two = np.zeros(inside.shape, dtype=np.int8)
    row, column = np.nonzero(inside)
    caveats = model.caveats({"capillary_number": ca[column], "size_ratio": size[row]})
    two[row, column] = caveats.get(TWO_SHAPES, np.zeros(len(row), dtype=bool))
    variables: dict[str, tuple[np.ndarray, str]] = {
        name: (values[field], meaning) for field, (name, meaning) in _MEANINGS.items()
    }
    variables["two_shapes"] = two, "1 where two steady shapes are stable"
    return plane_dataset(model, ca, size, variables, lab_attributes(model, experiment, errors) | {"noises": noises})


def over_plane(
    model: ForwardModel,
    ca: Floats,
    size: Floats,
    names: Iterable[str],
    compute: Callable[[float, float], Mapping[str, float]],
    *,
    progress: Progress | None,
) -> tuple[dict[str, Floats], Booleans]:
    """Compute values at each (Ca, a/l) within a model : (rows of a/l, columns of Ca) arrays by name, NaN outside it."""
    inside = np.stack([model.domain.contains(ca, np.full(len(ca), ratio)) for ratio in size])
    values = {name: np.full(inside.shape, np.nan) for name in names}
    points = list(zip(*np.nonzero(inside), strict=True))
    with threadpool_limits(limits=1):
        for row, column in points if progress is None else progress(points, len(points), "points of the map"):
            for name, value in compute(float(ca[column]), float(size[row])).items():
                values[name][row, column] = value
    return values, inside


def plane_dataset(
    model: ForwardModel,
    ca: Floats,
    size: Floats,
    variables: Mapping[str, tuple[np.ndarray, str]],
    attributes: Mapping[str, str | int],
) -> xr.Dataset:
    """Return arrays over the plane, with what they mean, and the borders of a model."""
    import xarray as xr

    data: dict[str, Any] = {
        name: (("size_ratio", "capillary_number"), values, {"units": "-", "long_name": meaning})
        for name, (values, meaning) in variables.items()
    }
    borders = Borders.of(model, size)
    for end, values in (("lowest", borders.lowest), ("highest", borders.highest)):
        data[end] = "size_ratio", values, {"units": "-", "long_name": f"{end} Ca"}
    places = {
        "capillary_number": ("capillary_number", ca, {"units": "-", "long_name": "Ca, mu U / G_s"}),
        "size_ratio": ("size_ratio", size, {"units": "-", "long_name": "a/l"}),
    }
    return xr.Dataset(data, places, attributes)
