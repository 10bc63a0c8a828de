"""Domain of existence of a joint surrogate: a part of the (Ca, a/l) plane for each value of the effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.model import CoordinateRange, Domain
from capsbayes.surrogate.joint.kernel import Weighing, covered


class Scale(NamedTuple):
    """Scale on which shapes are smooth functions of an effect."""

    place: Callable[[Floats], Floats]  # of a value there
    value: Callable[[Floats], Floats]  # at a place
    approximate: bool = False  # then what an interpolation over the values themselves differs by is an error


LINEAR = Scale(np.asarray, np.asarray)
SCALES: Mapping[str, Scale] = MappingProxyType(
    {
        "hardening": Scale(np.log, np.exp),  # it runs over decades
        # what is left of a transient decays about as exp(-U t/l)
        "unsteadiness": Scale(lambda value: np.exp(-1.0 / value), lambda place: -1.0 / np.log(place), approximate=True),
    }
)
"""Scales of the effects that are not linear."""


@dataclass(frozen=True, eq=False)
class EffectDomain(Domain):
    """Points (Ca, a/l, effect) where the joint surrogate has an answer."""

    weighing: Weighing  # with the borders that bound the domain
    scale: Scale  # on which the slices are knots
    coordinate: str  # name of the effect's parameter
    ends: CoordinateRange  # range of its values

    def place(self, value: ArrayLike) -> Floats:
        """Return the places of given values among the knots : array, NaN for a value without a logarithm."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.scale.place(np.asarray(value, dtype=np.float64)))

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        """Return whether each point lies in the domain, borders included : (n,) bool array; NaN is outside."""
        effect = self.place(coordinates[0] if coordinates else self.ends.null_value)
        arrays = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio), effect)
        ca, size, place = (np.ascontiguousarray(array, np.float64) for array in arrays)
        return np.asarray(covered(ca, size, place, self.weighing), dtype=np.bool_)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box around the domains of all slices, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        with np.errstate(divide="ignore"):
            boxes = [FixedDomain(self, value).bounds for value in self.scale.value(self.weighing.knots)]
        return (min(box[0][0] for box in boxes), max(box[0][1] for box in boxes)), boxes[0][1]

    def at(self, values: Mapping[str, float]) -> Domain:
        """Return the part of the plane at one value of the effect."""
        return FixedDomain(self, values[self.coordinate]) if self.coordinate in values else self

    def reason(self, capillary_number: float, size_ratio: float, **coordinates: float) -> str:
        """Say why a point lies outside the domain."""
        del capillary_number, size_ratio
        value = coordinates.get(self.coordinate, self.ends.null_value)
        low, high = self.ends.low, self.ends.high
        return f"at {self.coordinate} = {value:.4g}, of {low:.4g} to {high:.4g}, no steady shape is stored there"

    def borders(self, value: float) -> Floats:
        """Return the lowest Ca, the division and the highest Ca in each column at one value : (3, c) array."""
        place, knots = float(self.place(value)), self.weighing.knots
        interval = int(np.clip(np.searchsorted(knots, place, side="right") - 1, 0, len(knots) - 2))
        powers = (place - knots[interval]) ** np.arange(4)
        return np.asarray(np.tensordot(powers, self.weighing.borders[interval], axes=1))


@dataclass(frozen=True, eq=False)
class FixedDomain(Domain):
    """Part of a joint domain at one value of the effect."""

    whole: EffectDomain
    value: float

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        """Return whether each point lies in the domain, borders included : (n,) bool array; NaN is outside."""
        del coordinates
        return self.whole.contains(capillary_number, size_ratio, self.value)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box around it, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        borders, columns = self.whole.borders(self.value), self.whole.weighing.columns
        return (float(borders[0].min()), float(borders[2].max())), (float(columns[0]), float(columns[-1]))
