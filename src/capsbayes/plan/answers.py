"""The paper's deterministic answer for many samples of the inputs, with the nearest shape where there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import capsule_radius, mean_velocity, surface_shear_modulus
from capsbayes.infer.inputs import Inputs
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel

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
    centre: Mapping[str, float]  # value of each input that a sample does not state
    over_half_width: bool  # whether the lengths are over l or in metres
    nearest: NearestShape  # for lengths that no capsule of the database has

    @classmethod
    def of(cls, model: ForwardModel, measurement: Measurement, inputs: Inputs, sds: Mapping[str, float]) -> Answerer:
        """Set up the function for the inputs of one capsule; refuse a model without a database or with a coordinate."""
        # In units of the standard deviations of the lengths, over which they vary, shapes are near or far.
        if model.database is None or model.coordinates:
            raise InputError("sobol", "model", "a database of (Ca, a/l), as the paper's procedure needs", model.name)
        centre = {name: getattr(inputs, name).value for name in ("viscosity", "half_width", "capsule_velocity")}
        lengths = {name: float(getattr(measurement, name)) for name in ("axial_extent", "axial_length")}
        scale = 1.0 if measurement.over_half_width else centre["half_width"]
        relative = 0.0 if measurement.over_half_width else sds.get("half_width", 0.0) / centre["half_width"]
        own = [np.hypot(sds.get(name, 0.0), relative * length) / scale for name, length in lengths.items()]
        scales = np.maximum(own, 0.1 * max(*own, 1e-6))
        return cls(model, centre | lengths, measurement.over_half_width, NearestShape.of(model, scales))

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
