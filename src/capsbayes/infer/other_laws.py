"""What another law of the membrane would make of a capsule's shear modulus."""

from __future__ import annotations

import functools
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import DatabaseError
from capsbayes.experiment import Experiment, surface_shear_modulus
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.likelihood import LengthsLikelihood, ModelAtPoints
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.surrogate import MembraneSurrogate

if TYPE_CHECKING:
    from capsbayes.infer.posterior import Posterior

_LAW = ("area_dilation_modulus", "strain_hardening")
_CELLS = 40, 30  # along log Ca and a/l
_HALVINGS = 5  # of the cells about the best of them
_FARTHEST = 3.0  # standard errors between the lengths and the nearest shape of a law that counts


def with_other_laws(posterior: Posterior) -> Posterior:
    """Return a posterior of one law with the range of G_s over others, where the cross-section has a model of them."""
    try:
        model = _opened(posterior.experiment.cross_section)
    except DatabaseError:
        return posterior
    return replace(posterior, modulus_over_laws=modulus_over_laws(posterior.measurement, posterior.experiment, model))


def prepare(cross_section: str) -> None:
    """Begin to open the model that `with_other_laws` needs, on another processor while this one samples."""
    _begun(cross_section)


def _opened(cross_section: str) -> MembraneSurrogate:
    return _begun(cross_section).result()


@functools.cache
def _begun(cross_section: str) -> Future[MembraneSurrogate]:
    thread = ThreadPoolExecutor(1)
    future = thread.submit(MembraneSurrogate.open, cross_section)
    thread.shutdown(wait=False)
    return future


def modulus_over_laws(
    measurement: Measurement, experiment: Experiment, model: ForwardModel
) -> tuple[float, float] | None:
    """Return the least and the largest G_s [N/m] that laws at the ends of a model's ranges of K and h give.

    Of each law it is that of the shape whose lengths are nearest to the measured ones; viscosity, velocity and half
    width have their central values, and the other coordinates their null values.

    Parameters
    ----------
    measurement : Measurement
        With both lengths; without L_a a law has no single shape, and the answer is None.
    experiment : Experiment
    model : ForwardModel
        With K and h as coordinates, as a `MembraneSurrogate`.

    Returns
    -------
    tuple of float, or None
        None also if fewer than two laws have such a shape.
    """
    if measurement.axial_length is None:
        return None
    seen = LengthsLikelihood.of(measurement).with_half_width(experiment.half_width.value, experiment.half_width.error)
    ends = [
        (model.coordinates[name].low, model.coordinates[name].null_value, model.coordinates[name].high) for name in _LAW
    ]
    inputs, found = Inputs.of(measurement, experiment), []
    for law in product(*ends):
        place = _nearest(model.fixed(**dict(zip(_LAW, law, strict=True))), seen)
        if place is not None:
            flow, viscosity = inputs.mean_velocity(place[1]), inputs.viscosity.value
            found.append(surface_shear_modulus(viscosity=viscosity, mean_velocity=flow, capillary_number=place[0]))
    return (float(min(found)), float(max(found))) if len(found) > 1 else None


def _nearest(model: ForwardModel, seen: LengthsLikelihood) -> tuple[float, float] | None:
    """Return Ca and v_o/U of the shape with the nearest lengths, None if it is too far."""
    bounds = np.array(model.domain.bounds)
    low, high = np.array([np.log(bounds[0, 0]), bounds[1, 0]]), np.array([np.log(bounds[0, 1]), bounds[1, 1]])
    cell = (high - low) / _CELLS
    offsets = np.stack(np.meshgrid(*(np.arange(count) + 0.5 for count in _CELLS), indexing="ij"), axis=-1)
    points: Floats = low + cell * offsets.reshape(-1, 2)
    for _ in range(_HALVINGS + 1):
        there = ModelAtPoints.of(model({"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}))
        distance = np.nan_to_num(seen.distance(there), nan=np.inf)
        best = int(np.argmin(distance))
        around = np.stack(np.meshgrid(*2 * [np.arange(-2, 3) / 2.0], indexing="ij"), axis=-1).reshape(-1, 2)
        nearest = points[best], distance[best], there.velocity_ratio[best]
        points, cell = points[best] + cell * around, 0.5 * cell
    if nearest[1] > _FARTHEST:
        return None
    return float(np.exp(nearest[0][0])), float(nearest[2])
