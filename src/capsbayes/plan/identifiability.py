"""Identifiability map: expected widths of the posterior of G_s and a over the plane (Ca, a/l)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.model import TWO_SHAPES, ForwardModel
from capsbayes.plan.borders import range_at
from capsbayes.plan.lab_errors import LabErrors
from capsbayes.plan.widths import NOISES, Width, WidthPredictor

if TYPE_CHECKING:
    import xarray as xr

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
