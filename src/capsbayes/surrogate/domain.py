"""Domain of existence: the part of the (Ca, a/l) plane that the steady shapes of a database cover.

The cases stand in columns of equal a/l. At each column the domain runs from
the lowest Ca that converged to the highest one, at most the limit of
existence; between columns both borders are straight. Nothing is extrapolated:
outside, the approximation has no answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from capsbayes.database import Database
from capsbayes.errors import DatabaseError

__all__ = ["DomainOfExistence", "inside_borders"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DomainOfExistence:
    """Region between two polygonal lines over a/l.

    Parameters
    ----------
    size_ratio : (k,) array [-]
        a/l of the columns, rising.
    lowest, highest : (k,) array [-]
        Borders in Ca at each column.
    limit : (k,) bool array
        True where the upper border is a limit of existence, False where the database merely ends.

    Examples
    --------
    >>> domain = DomainOfExistence(np.array([0.8, 1.0]), np.array([0.01, 0.02]), np.array([0.15, 0.11]),
    ...                            np.array([False, True]))
    >>> domain.contains([0.05, 0.14, np.nan], [0.9, 0.9, 0.9]).tolist()
    [True, False, False]
    """

    size_ratio: Floats
    lowest: Floats
    highest: Floats
    limit: NDArray[np.bool_]

    @classmethod
    def of(cls, database: Database) -> DomainOfExistence:
        """Read the domain from a database's converged cases and border curve.

        Raises
        ------
        DatabaseError
            When fewer than two columns of a/l hold two converged cases.
        """
        cases = database.converged
        ca, size = cases["capillary_number"], np.round(cases["size_ratio"], 6)
        columns = np.array([s for s in np.unique(size) if np.count_nonzero(size == s) > 1])
        if len(columns) < 2:
            raise DatabaseError(
                f"expected at least two columns of a/l with two converged cases each, got {len(columns)}"
            )
        lowest = np.array([ca[size == s].min() for s in columns])
        highest = np.array([ca[size == s].max() for s in columns])
        nearest = np.argmin(np.abs(database["border_size_ratio"][None] - columns[:, None]), axis=1)
        limit = database["border_kind"][nearest] == "limit of existence"
        return cls(columns, lowest, highest, limit)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box around the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""
        return (
            (float(self.lowest.min()), float(self.highest.max())),
            (float(self.size_ratio[0]), float(self.size_ratio[-1])),
        )

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point lies in the domain, borders included : (n,) bool array; NaN is outside."""
        ca, size = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio))
        ca, size = np.ascontiguousarray(ca, np.float64), np.ascontiguousarray(size, np.float64)
        return _contains(ca, size, self.size_ratio, self.lowest, self.highest)

    def reason(self, capillary_number: float, size_ratio: float) -> str:
        """Say on which side of the domain a point outside it lies."""
        first, last = self.size_ratio[0], self.size_ratio[-1]
        if not (np.isfinite(capillary_number) and np.isfinite(size_ratio)):
            return "expected finite numbers"
        if not first <= size_ratio <= last:
            return f"a/l runs from {first:.4g} to {last:.4g}"
        lowest = np.interp(size_ratio, self.size_ratio, self.lowest)
        highest = np.interp(size_ratio, self.size_ratio, self.highest)
        if capillary_number < lowest:
            return f"the lowest Ca computed at this a/l is {lowest:.4g}"
        nearest = int(np.argmin(np.abs(self.size_ratio - size_ratio)))
        what = "no steady shape is known above" if self.limit[nearest] else "the database ends at"
        return f"at this a/l {what} Ca = {highest:.4g}"


@njit(cache=True, nogil=True)
def inside_borders(ca, size, columns, lowest, highest):  # type: ignore[no-untyped-def]
    """Whether one point lies between the polygonal borders (compiled; NaN is outside)."""
    if not (columns[0] <= size <= columns[-1]):
        return False
    left, right = 0, len(columns) - 1
    while right - left > 1:
        middle = (left + right) // 2
        if columns[middle] <= size:
            left = middle
        else:
            right = middle
    share = (size - columns[left]) / (columns[right] - columns[left])
    below = (1.0 - share) * lowest[left] + share * lowest[right]
    above = (1.0 - share) * highest[left] + share * highest[right]
    return below <= ca <= above


@njit(cache=True, nogil=True)
def _contains(ca, size, columns, lowest, highest):  # type: ignore[no-untyped-def]
    inside = np.empty(len(ca), np.bool_)
    for i in range(len(ca)):
        inside[i] = inside_borders(ca[i], size[i], columns, lowest, highest)
    return inside
