"""Branches of steady shapes: parachutes (concave rear) and, at low Ca in a narrow channel, convex shapes.

From one branch to the other the shape jumps, or changes with a kink, so no
smooth approximation may average over both. The parachute depth of a case decides
its branch. In each column of a/l the border between the branches lies
between the highest convex case and the lowest parachute: at the snap-through if
the database names one; where the rear turns concave smoothly, at the onset; else
half way in sqrt(Ca). Between those two cases the branch of a capsule is unknown:
this gap is stored with the branches. Elsewhere a branch ends
at its own last converged case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import LIMIT_OF_EXISTENCE, LOST_FROM_REST, SNAP_THROUGH, Database
from capsbayes.errors import DatabaseError
from capsbayes.surrogate.domain import Region

CONVEX = 1e-4  # L_p/l below which a rear counts as convex; the cases have 0, or 0.02 and more
FEWEST_CASES = 9
SAME_COLUMN = 1e-6


@dataclass(frozen=True, eq=False)
class Branch:
    """Branch of steady shapes, ``"parachute"`` or ``"convex"``."""

    name: str
    rows: Integers  # (c,): its rows among the converged cases
    region: Region  # where the steady shape is of this branch
    gap: Region | None  # where it may be of this branch or of the other


def branches_of(database: Database) -> tuple[Branch, ...]:
    """Sort the converged cases into branches; omit one that is too small to approximate, refuse if none is left."""
    # A branch needs two columns of a/l with two cases each and nine cases in all.
    cases = database.converged
    ca, size = cases["capillary_number"], np.round(cases["size_ratio"], 6)
    convex = cases["parachute_depth"] < CONVEX
    columns = np.unique(size)
    low, high = np.array([_gap(ca[(size == s) & convex], ca[(size == s) & ~convex]) for s in columns]).T
    division = np.array([_division(cases, *ends) for ends in zip(columns, low, high, strict=True)])
    limit = _is_limit(cases, columns)
    split = np.isfinite(division)
    gap = _gap_region(columns, low, high, np.array([ca[size == s].min() for s in columns]))
    below = ca < division[np.searchsorted(columns, size)]
    branches = []
    for name, member in (("parachute", ~convex & ~below), ("convex", convex)):
        rows = np.flatnonzero(member)
        kept = np.array([np.count_nonzero(size[rows] == s) > 1 for s in columns], dtype=bool)
        if np.count_nonzero(kept) < 2 or len(rows) < FEWEST_CASES:
            continue
        lowest = np.array([ca[rows][size[rows] == s].min() for s in columns[kept]])
        highest = np.array([ca[rows][size[rows] == s].max() for s in columns[kept]])
        if name == "parachute":
            lowest = np.where(split[kept], division[kept], lowest)
        else:
            highest = division[kept]
        branches.append(Branch(name, rows, Region(columns[kept], lowest, highest, limit[kept]), gap))
    if not branches:
        raise DatabaseError(
            f"expected at least {FEWEST_CASES} converged cases of one kind, and two columns of a/l with two each, "
            f"got {len(ca)} cases in {len(columns)} columns"
        )
    return tuple(branches)


def _gap(convex: Floats, parachute: Floats) -> tuple[float, float]:
    """Return the highest convex and the lowest parachute Ca of one column; ignore parachutes below a convex case."""
    if not convex.size:
        return np.nan, np.nan
    above = parachute[parachute > convex.max()]
    return float(convex.max()), float(above.min() if above.size else convex.max())


def _division(cases: Database, column: float, low: float, high: float) -> float:
    """Return the border between the branches in the gap of one column, NaN without a convex case."""
    named = (np.abs(cases["border_size_ratio"] - column) < SAME_COLUMN) & (cases["border_kind"] == SNAP_THROUGH)
    candidates = list(cases["border_capillary_number"][named])
    above = (np.abs(cases["size_ratio"] - column) < SAME_COLUMN) & (cases["capillary_number"] >= high)
    ca = cases["capillary_number"][above]
    first = np.argsort(ca)[:2]
    ca, root = ca[first], np.sqrt(cases["parachute_depth"][above][first])
    if len(ca) == 2 and root[0] < root[1]:  # where a rear turns concave smoothly, its depth grows as a square
        candidates.append(ca[0] - root[0] * (ca[1] - ca[0]) / (root[1] - root[0]))
    return next((float(border) for border in candidates if low <= border <= high), (low**0.5 + high**0.5) ** 2 / 4)


def _gap_region(columns: Floats, low: Floats, high: Floats, lowest: Floats) -> Region | None:
    """Return the gap over the columns that have one; it closes at the lowest case of the neighbouring columns."""
    split = np.isfinite(low)
    if not split.any() or len(columns) < 2:
        return None
    next_to = binary_dilation(split) & ~split
    low, high, kept = np.where(next_to, lowest, low), np.where(next_to, lowest, high), split | next_to
    return Region(columns[kept], low[kept], high[kept], np.zeros(np.count_nonzero(kept), dtype=bool))


def _is_limit(cases: Database, columns: Floats) -> Booleans:
    upper = ~np.isin(cases["border_kind"], (SNAP_THROUGH, LOST_FROM_REST))
    if not upper.any():
        return np.zeros(len(columns), dtype=np.bool_)
    nearest = np.argmin(np.abs(cases["border_size_ratio"][upper] - columns[:, None]), axis=1)
    return cases["border_kind"][upper][nearest] == LIMIT_OF_EXISTENCE
