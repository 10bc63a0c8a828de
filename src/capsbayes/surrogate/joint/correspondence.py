"""Correspondence of the points of two slices: the borders of the branches move with the effect.

A *slice* is the surrogate at one value of the effect. In every column of a/l
its convex shapes lie between a lowest Ca and a division, its parachutes
between the division and a highest Ca. All three depend on the effect: a
pre-inflated capsule stays convex up to a higher Ca and exists up to a higher one. Points of two
slices correspond when they have the same a/l, belong to the same branch, and have
the same Ca, except next to the borders, which they follow. So a capsule at the
onset of its dimple is compared with one at the onset, and values of different
branches are never mixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.interpolate import PchipInterpolator

from capsbayes.arrays import Booleans, Floats
from capsbayes.surrogate.domain import between_columns
from capsbayes.surrogate.plane_surrogate import PlaneSurrogate

PARACHUTE, CONVEX = 0, 1
BRANCHES = ("parachute", "convex")
"""Names of the branches, in the order of their numbers."""
ROUNDING = 1e-9  # of a/l


@dataclass(frozen=True, eq=False)
class Borders:
    """Borders of the branches of one slice."""

    size_ratio: Floats  # (c,): columns, increasing
    capillary_number: Floats  # (3, c): lowest Ca, division and highest Ca, linear between columns
    limit: Booleans  # (c,): whether the highest Ca is a limit of existence
    known: Booleans  # (2, c - 1): whether it has parachutes, and convex shapes, between two columns

    @classmethod
    def of(cls, surrogate: PlaneSurrogate, columns: Floats) -> Borders:
        """Return those of a surrogate at given columns within its own."""
        regions = {part.branch.name: part.branch.region for part in surrogate.branches}
        middle = (columns[1:] + columns[:-1]) / 2
        known, ends = np.zeros((2, len(middle)), dtype=np.bool_), np.full((2, 2, len(columns)), np.nan)
        for row, name in enumerate(BRANCHES):
            region = regions.get(name)
            if region is not None:
                first, last = region.size_ratio[[0, -1]]
                known[row] = (middle > first) & (middle < last)
                inside = (columns > first - ROUNDING) & (columns < last + ROUNDING)
                for end, border in enumerate((region.lowest, region.highest)):
                    ends[row, end, inside] = np.interp(columns[inside], region.size_ratio, border)
        (lowest_parachute, highest_parachute), (lowest_convex, highest_convex) = ends
        division = np.where(np.isnan(highest_convex), lowest_parachute, highest_convex)
        lowest = np.where(np.isnan(lowest_convex), lowest_parachute, lowest_convex)
        highest = np.where(np.isnan(highest_parachute), highest_convex, highest_parachute)
        last = surrogate.branches[0].branch.region  # of the parachutes, if it has any
        limit = np.interp(columns, last.size_ratio, last.limit) == 1.0
        return cls(columns, np.stack([lowest, division, highest]), limit, known)

    def with_convex_of(self, other: Borders) -> Borders:
        """Take the lowest Ca and the division of the other at columns where only the other has convex shapes."""
        # Columns where these end below the lowest Ca of this one stay as they are.
        mine, theirs = self.capillary_number, other.capillary_number
        lacking = (mine[1] <= mine[0]) & (theirs[1] > theirs[0]) & (theirs[1] < mine[2]) & (theirs[1] > mine[0])
        return replace(self, capillary_number=np.where(lacking & (np.arange(3) < 2)[:, None], theirs, mine))


def matched(base: Borders, null: Borders) -> tuple[Borders, Borders]:
    """Make base and null slice correspond at equal Ca, except for their divisions and limits of existence."""
    # A column ends where the computation of one of the two ends, unless both end in a fold, which moves with the mesh
    # and the shapes with it.
    base, null = base.with_convex_of(null), null.with_convex_of(base)
    ends = []
    for borders, other in ((base, null), (null, base)):
        mine, theirs = borders.capillary_number, other.capillary_number
        highest = np.where(base.limit & null.limit, mine[2], np.minimum(mine[2], theirs[2]))
        lowest = np.minimum(np.maximum(mine[0], theirs[0]), highest)
        ends.append(replace(borders, capillary_number=np.stack([lowest, np.clip(mine[1], lowest, highest), highest])))
    return ends[0], ends[1]


def moving_borders(knots: Floats, slices: list[Borders], null: int, base: Borders) -> Floats:
    """Return the borders as functions of the effect, monotone cubics between the knots : (k - 1, 4, 3, c) array."""
    # Coefficients, from the constant on, of the distance from the lower knot. The lowest and the highest Ca are those
    # of the base, moved as those of the slices: a limit of existence moves with the mesh at every value of the effect.
    # Where a capsule snaps through depends on the smallest differences, and what the mesh does to it at the null value
    # says nothing of other values: the division is that of the base at the null value, and that of the slice at all
    # others.
    borders = np.stack([each.capillary_number for each in slices])
    moved = borders + (base.capillary_number - borders[null])
    moved[:, 1] = borders[:, 1]
    moved[null] = base.capillary_number
    return PchipInterpolator(knots, moved).c.transpose(1, 0, 2, 3)[:, ::-1].copy()


def common_folds(slices: list[Borders], base: Borders) -> Booleans:
    """Return whether the highest Ca is a limit of existence at both ends of an interval and of the base : (k-1, c-1)"""
    limit = np.stack([borders.limit for borders in slices])
    at_columns = limit[1:] & limit[:-1] & base.limit
    return np.asarray(at_columns[:, 1:] & at_columns[:, :-1])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def place(ca, size, distance, columns, cubics, out):  # type: ignore[no-untyped-def]
    """Return branch (0 or 1, -1 if none), column and position of one point between the borders of one interval.

    Parameters
    ----------
    ca, size, distance : float
        The point, and the distance of the effect from the lower knot of the interval.
    columns : (c,) array
    cubics : (4, 3, c) array
        Borders in this interval.
    out : (4,) array
        Filled with the position within the range of Ca of the branch, from 0 to 1, that between the columns, and both
        ends of the range.
    """
    if not (columns[0] <= size <= columns[-1]):
        return -1, 0
    left, share = between_columns(size, columns)
    lowest = border(cubics, 0, left, share, distance)
    highest = border(cubics, 2, left, share, distance)
    division = min(max(border(cubics, 1, left, share, distance), lowest), highest)
    if not (lowest <= ca <= highest):
        return -1, left
    out[1] = share
    if ca < division:
        out[0], out[2], out[3] = (ca - lowest) / (division - lowest), lowest, division
        return CONVEX, left
    out[0], out[2], out[3] = (ca - division) / max(highest - division, 1e-300), division, highest
    return PARACHUTE, left


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def border(cubics, which, column, share, distance):  # type: ignore[no-untyped-def]
    """Return Ca of one of the three borders, between two columns."""
    left = right = 0.0
    for power in range(3, -1, -1):
        left = left * distance + cubics[power, which, column]
        right = right * distance + cubics[power, which, column + 1]
    return (1.0 - share) * left + share * right
