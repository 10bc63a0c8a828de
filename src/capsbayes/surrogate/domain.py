"""Domain of existence: the part of the (Ca, a/l) plane that the steady shapes of a database cover.

It is the union of one region for each branch of steady shapes, each between two
polygonal lines over a/l. Outside, the approximation has no answer: nothing is
extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.model import Domain


@dataclass(frozen=True, eq=False)
class Region:
    """Region between a lowest and a highest Ca, both given at columns of a/l and linear between them."""

    size_ratio: Floats  # (k,): of the columns, rising, k > 1
    lowest: Floats  # (k,): border in Ca
    highest: Floats  # (k,): border in Ca
    limit: Booleans  # (k,): True where the upper border is a limit of existence, False where the database ends

    def contains(self, capillary_number: Floats, size_ratio: Floats) -> Booleans:
        """Return whether each point lies in the region, borders included : (n,) bool array; NaN is outside."""
        return _contains(capillary_number, size_ratio, self.size_ratio, self.lowest, self.highest)

    def borders(self, size_ratio: float) -> tuple[float, float]:
        """Return the lowest and the highest Ca at one a/l."""
        return (
            float(np.interp(size_ratio, self.size_ratio, self.lowest)),
            float(np.interp(size_ratio, self.size_ratio, self.highest)),
        )


@dataclass(frozen=True, eq=False)
class DomainOfExistence(Domain):
    """Points (Ca, a/l) for which a surrogate has an answer: the union of the regions of its branches.

    Parameters
    ----------
    regions : tuple of Region
        One for each branch, without overlap.

    Examples
    --------
    >>> region = Region(np.array([0.8, 1.0]), np.array([0.01, 0.02]), np.array([0.15, 0.11]), np.array([False, True]))
    >>> DomainOfExistence((region,)).contains([0.05, 0.14, np.nan], [0.9, 0.9, 0.9]).tolist()
    [True, False, False]
    """

    regions: tuple[Region, ...]

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box around the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        lowest = min(float(region.lowest.min()) for region in self.regions)
        highest = max(float(region.highest.max()) for region in self.regions)
        first = min(float(region.size_ratio[0]) for region in self.regions)
        last = max(float(region.size_ratio[-1]) for region in self.regions)
        return (lowest, highest), (first, last)

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        """Return whether each point lies in the domain, borders included : (n,) bool array; NaN is outside."""
        del coordinates
        ca, size = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio))
        ca, size = np.ascontiguousarray(ca, np.float64), np.ascontiguousarray(size, np.float64)
        inside = np.zeros(len(ca), dtype=np.bool_)
        for region in self.regions:
            inside |= region.contains(ca, size)
        return inside

    def is_limit_of_existence(self, size_ratio: float) -> bool:
        """Return whether no steady shape exists above the highest Ca at this a/l, as opposed to none computed."""
        top = max(self._at(size_ratio), key=lambda region: region.borders(size_ratio)[1], default=None)
        return top is not None and bool(top.limit[int(np.argmin(np.abs(top.size_ratio - size_ratio)))])

    def reason(self, capillary_number: float, size_ratio: float, **coordinates: float) -> str:
        """Say on which side of the domain a point outside it lies."""
        del coordinates
        first, last = self.bounds[1]
        if not (np.isfinite(capillary_number) and np.isfinite(size_ratio)):
            return "expected finite numbers"
        if not first <= size_ratio <= last:
            return f"a/l runs from {first:.4g} to {last:.4g}"
        lowest = min(region.borders(size_ratio)[0] for region in self._at(size_ratio))
        if capillary_number < lowest:
            return f"the lowest Ca computed at this a/l is {lowest:.4g}"
        highest = max(region.borders(size_ratio)[1] for region in self._at(size_ratio))
        if capillary_number <= highest:
            return "it lies between two branches of steady shapes"
        end = "no steady shape is known above" if self.is_limit_of_existence(size_ratio) else "the database ends at"
        return f"at this a/l {end} Ca = {highest:.4g}"

    def _at(self, size_ratio: float) -> list[Region]:
        return [region for region in self.regions if region.size_ratio[0] <= size_ratio <= region.size_ratio[-1]]


@njit(cache=True, nogil=True)
def inside_borders(ca, size, columns, lowest, highest):  # type: ignore[no-untyped-def]
    """Return whether one point lies between the polygonal borders (compiled; NaN is outside)."""
    if not (columns[0] <= size <= columns[-1]):
        return False
    left, share = between_columns(size, columns)
    below = (1.0 - share) * lowest[left] + share * lowest[left + 1]
    above = (1.0 - share) * highest[left] + share * highest[left + 1]
    return below <= ca <= above


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def between_columns(size, columns):  # type: ignore[no-untyped-def]
    """Return the column at or below an a/l within the columns, and the share of the way to the next."""
    left, right = 0, len(columns) - 1
    while right - left > 1:
        middle = (left + right) // 2
        if columns[middle] <= size:
            left = middle
        else:
            right = middle
    return left, (size - columns[left]) / (columns[right] - columns[left])


@njit(cache=True, nogil=True)
def _contains(ca, size, columns, lowest, highest):  # type: ignore[no-untyped-def]
    inside = np.empty(len(ca), np.bool_)
    for i in range(len(ca)):
        inside[i] = inside_borders(ca[i], size[i], columns, lowest, highest)
    return inside
