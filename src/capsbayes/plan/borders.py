"""Range of capillary numbers in which a model has shapes of one size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.model import ForwardModel

_SCANNED = 4001


@dataclass(frozen=True)
class CaRange:
    """Range of Ca at one a/l.

    Parameters
    ----------
    size_ratio : float
    lowest, highest : float
        Ends of the model; NaN where it has no shape of this size.
    limit : bool
        Whether no steady shape is known above the highest, rather than none computed.
    """

    size_ratio: float
    lowest: float
    highest: float
    limit: bool

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
