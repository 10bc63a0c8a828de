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
from capsbayes.plan.lab import LabErrors, ModelEnds, lab_attributes
from capsbayes.plan.widths import NOISES, WidthPredictor, check_model

if TYPE_CHECKING:
    import xarray as xr

Progress = Callable[[Iterable, int, str], Iterable]
"""Wrapper of the points that are computed, given their number and a title, to show progress."""

GRID = (28, 20)
"""Points along log Ca and along a/l."""

WITHIN = 1e-9
"""Margin that keeps the ends of a grid inside the domain despite rounding."""

_PLANE = ("size_ratio", "capillary_number")
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

    def widths(*place: float) -> dict[str, float]:
        width = asdict(predictor.at(*place))
        return {name: width[field] for field, (name, _) in _MEANINGS.items()}

    attributes = lab_attributes(model, experiment, errors) | {"noises": noises}
    found = over_plane(model, ca, size, dict(_MEANINGS.values()), widths, attributes, progress=progress)
    row, column = np.nonzero(inside_of(model, ca, size))
    caveats = model.caveats({"capillary_number": ca[column], "size_ratio": size[row]})
    two = np.zeros((len(size), len(ca)), dtype=np.int8)
    two[row, column] = caveats.get(TWO_SHAPES, False)
    return found.assign(two_shapes=(_PLANE, two, {"units": "-", "long_name": "1 where two steady shapes are stable"}))


def inside_of(model: ForwardModel, ca: Floats, size: Floats) -> Booleans:
    """Return where a model has a shape : (rows of a/l, columns of Ca) bool array."""
    return np.stack([model.domain.contains(ca, np.full(len(ca), ratio)) for ratio in size])


def over_plane(
    model: ForwardModel,
    ca: Floats,
    size: Floats,
    meanings: Mapping[str, str],
    compute: Callable[[float, float], Mapping[str, float]],
    attributes: Mapping[str, str | int],
    *,
    progress: Progress | None,
) -> xr.Dataset:
    """Compute values of given names and meanings at each (Ca, a/l) within a model, NaN outside, and its borders."""
    import xarray as xr

    inside = inside_of(model, ca, size)
    values = {name: np.full(inside.shape, np.nan) for name in meanings}
    points = list(zip(*np.nonzero(inside), strict=True))
    with threadpool_limits(limits=1):
        for row, column in points if progress is None else progress(points, len(points), "points of the map"):
            for name, value in compute(float(ca[column]), float(size[row])).items():
                values[name][row, column] = value
    data: dict[str, Any] = {
        name: (_PLANE, values[name], {"units": "-", "long_name": meaning}) for name, meaning in meanings.items()
    }
    borders = ModelEnds.of(model, size)
    for end, border in (("lowest", borders.lowest), ("highest", borders.highest)):
        data[end] = "size_ratio", border, {"units": "-", "long_name": f"{end} Ca"}
    places = {
        "capillary_number": ("capillary_number", ca, {"units": "-", "long_name": "Ca, mu U / G_s"}),
        "size_ratio": ("size_ratio", size, {"units": "-", "long_name": "a/l"}),
    }
    return xr.Dataset(data, places, attributes)
