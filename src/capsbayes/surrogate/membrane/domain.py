"""Domain of existence of the surrogate over the membrane's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, RANGES, covered
from capsbayes.model import Domain
from capsbayes.surrogate.membrane.coordinates import Frame
from capsbayes.surrogate.membrane.kernel import reached
from capsbayes.surrogate.membrane.local_fits import LocalFits


@dataclass(frozen=True, eq=False)
class MembraneDomain(Domain):
    """Points that enough polynomials reach, and that are nearer to a state than to a lost one."""

    frame: Frame
    fits: LocalFits
    cross_section: str

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box around it, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        return RANGES[0], RANGES[1]

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *further: ArrayLike) -> Booleans:
        """Return whether each point lies in the domain : (n,) bool array; NaN is outside."""
        columns = (capillary_number, size_ratio, *further, *NULL_VALUES[2 + len(further) :])
        arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(column, np.float64)) for column in columns))
        values = np.stack(arrays, axis=1)
        inside = covered(values, self.cross_section)
        inside[inside] = reached(self.frame.points(values[inside]), *self.fits[:5])
        return inside

    def at(self, values: Mapping[str, float]) -> Domain:
        """Return the domain over (Ca, a/l) at given values of further coordinates."""
        return FixedMembraneDomain(self, dict(values))

    def reason(self, capillary_number: float, size_ratio: float, **further: float) -> str:
        """Say why a point lies outside the domain."""
        known = dict(zip(FREE_PARAMETERS, NULL_VALUES, strict=True)) | further
        known |= {"capillary_number": capillary_number, "size_ratio": size_ratio}
        for name, (low, high) in zip(FREE_PARAMETERS, RANGES, strict=True):
            if not low <= known[name] <= high:
                return f"{name} = {known[name]:.4g} lies outside {low:.4g} to {high:.4g}"
        return "no steady shape is stored there"


@dataclass(frozen=True, eq=False)
class FixedMembraneDomain(Domain):
    """Part of the domain at given values, by name, of some of the membrane's parameters."""

    whole: Domain
    held: Mapping[str, float]

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box around the whole, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        return self.whole.bounds

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *further: ArrayLike) -> Booleans:
        """Return whether each point lies in the domain : (n,) bool array; NaN is outside."""
        others = [name for name in FREE_PARAMETERS[2:] if name not in self.held]
        known = (
            dict(zip(FREE_PARAMETERS, NULL_VALUES, strict=True))
            | dict(self.held)
            | dict(zip(others, further, strict=False))
        )
        return self.whole.contains(capillary_number, size_ratio, *(known[name] for name in FREE_PARAMETERS[2:]))

    def at(self, values: Mapping[str, float]) -> Domain:
        """Return the part at given values of further parameters too."""
        return FixedMembraneDomain(self.whole, {**self.held, **values})

    def reason(self, capillary_number: float, size_ratio: float, **further: float) -> str:
        """Say why a point lies outside the domain."""
        return self.whole.reason(capillary_number, size_ratio, **{**self.held, **further})
