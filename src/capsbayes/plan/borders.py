"""Range of capillary numbers in which a model has shapes of one size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.model import ForwardModel

_SCANNED = 4001


@dataclass(frozen=True)
class CaRange:
    """Range of Ca at one a/l."""

    size_ratio: float
    lowest: float  # end of the model; NaN where it has no shape of this size
    highest: float
    limit: bool  # whether no steady shape is known above the highest, rather than none computed

    @property
    def empty(self) -> bool:
        """True if the model has no shape of this size."""
        return not np.isfinite(self.highest)

    def inner(self, count: int) -> Floats:
        """Return points in equal ratios from end to end, a thousandth within them : (count,) array."""
        return np.geomspace(1.001 * self.lowest, 0.999 * self.highest, count)


def range_at(model: ForwardModel, size_ratio: float) -> CaRange:
    """Return the range of Ca of a model at one a/l."""
    low, high = model.domain.bounds[0]
    ca = np.geomspace(low, high, _SCANNED)
    within = np.flatnonzero(model.domain.contains(ca, np.full(_SCANNED, size_ratio)))
    if not within.size:
        return CaRange(size_ratio, np.nan, np.nan, False)
    highest = float(ca[within[-1]])
    return CaRange(size_ratio, float(ca[within[0]]), highest, model.domain.is_limit_of_existence(size_ratio))


@dataclass(frozen=True, eq=False)
class Borders:
    """Range of Ca of a model over a/l, to be read at many capsules."""

    sizes: Floats  # (b,): a/l, rising
    lowest: Floats  # (b,): end of the model there
    highest: Floats

    @classmethod
    def of(cls, model: ForwardModel, sizes: Floats) -> Borders:
        """Return those of a model at sizes (b,) that it has."""
        ranges = [range_at(model, float(size)) for size in sizes]
        return cls(sizes, *(np.array([getattr(one, end) for one in ranges]) for end in ("lowest", "highest")))

    def at(self, size: Floats) -> tuple[Floats, Floats]:
        """Return the lowest and the highest Ca at sizes : (n,) arrays."""
        return np.interp(size, self.sizes, self.lowest), np.interp(size, self.sizes, self.highest)
