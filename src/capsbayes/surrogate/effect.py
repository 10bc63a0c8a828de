"""The surrogate over (log Ca, a/l) and one further coordinate of an effect."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import factorial
from types import MappingProxyType
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import Database
from capsbayes.errors import DatabaseError
from capsbayes.model import CoordinateRange, Domain
from capsbayes.prediction import NUMBERS, Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.diffuse import hermite
from capsbayes.surrogate.plane import (
    BranchSurrogate,
    DatabaseModel,
    OwnError,
    PlaneSurrogate,
    aligned,
    between_columns,
    bilinear,
)

# Interpolation along one coordinate as weights of the values at its knots.
#
# Between two knots a cubic has at either end the value there and the slope of the parabola through the knot and its
# neighbours: smooth, exact for parabolas, and with small weights however uneven the knots. It is linear in the values,
# so one set of weights serves every quantity. Knots without a value are omitted

FEWEST_KNOTS = 3  # without one of them, two still give a slope


class CardinalCubics:
    """Weights of the values at k rising knots, cubics in each of the k - 1 intervals.

    >>> cubics = CardinalCubics(np.array([0.0, 1.0, 2.0, 4.0]), np.ones(4, dtype=bool))
    >>> cubics.weights(1.5).round(4).tolist()
    [-0.0625, 0.5833, 0.5, -0.0208]
    """

    # `cubics` (k - 1, 4, k) are coefficients, from the constant on, of the weights as polynomials of the distance from
    # the lower knot; NaN beyond the known knots. `left_out` (k - 1, 2, k) are, for the known knots `ends` (k - 1, 2) at
    # the two ends of an interval, the weights that give the value there from all other known knots less the value
    # itself, over the root of the number of such knots: the mean square of the two is the sum of squares. Zero at the
    # first and the last known knot, which others cannot give.

    def __init__(self, knots: Floats, known: Booleans) -> None:
        count, rows, one_each = len(knots), np.flatnonzero(known), np.eye(len(knots))
        if len(rows) < FEWEST_KNOTS:
            raise ValueError(f"known: expected at least {FEWEST_KNOTS} knots with a value, got {len(rows)}")
        self.knots = knots
        self.cubics, self.ends = np.full((count - 1, 4, count), np.nan), np.full((count - 1, 2), np.nan)
        self.left_out = np.zeros((count - 1, 2, count))
        spline = _through(knots[rows], one_each[rows])
        for i in range(rows[0], rows[-1]):
            for power in range(4):
                self.cubics[i, power] = spline(knots[i], nu=power) / factorial(power)
            around = rows[rows <= i][-1], rows[rows > i][0]
            self.ends[i] = knots[list(around)]
            inner = [rows[0] < end < rows[-1] for end in around]
            for side, end in enumerate(around):
                if inner[side]:
                    others = rows[rows != end]
                    rest = _through(knots[others], one_each[others])
                    self.left_out[i, side] = (rest(knots[end]) - one_each[end]) / np.sqrt(sum(inner))

    def weights(self, place: float) -> Floats:
        """Return the weights of the values at the knots in the value at a place : (k,) array, NaN beyond the known."""
        interval = int(np.clip(np.searchsorted(self.knots, place, side="right") - 1, 0, len(self.knots) - 2))
        powers = (place - self.knots[interval]) ** np.arange(4)
        return np.asarray(powers @ self.cubics[interval])


def _through(knots: Floats, values: Floats) -> CubicHermiteSpline:
    slopes = np.gradient(values, knots, axis=0, edge_order=2 if len(knots) > 2 else 1)
    return CubicHermiteSpline(knots, values, slopes)


# Correspondence of the points of two slices: the borders of the branches move with the effect.
#
# A *slice* is the surrogate at one value of the effect. In every column of a/l its convex shapes lie between a lowest
# Ca and a division, its parachutes between the division and a highest Ca. All three depend on the effect: a
# pre-inflated capsule stays convex up to a higher Ca and exists up to a higher one. Points of two slices correspond
# when they have the same a/l, belong to the same branch, and have the same Ca, except next to the borders, which they
# follow. So a capsule at the onset of its dimple is compared with one at the onset, and values of different branches
# are never mixed

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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def place(ca, size, distance, columns, cubics, out):  # type: ignore[no-untyped-def]
    """Return branch (0 or 1, -1 if none) and column of one point, a distance from the lower knot of an interval.

    Of the borders `cubics` (4, 3, c) there. Filled into `out` (4,) are the position within the range of Ca of the
    branch, from 0 to 1, that between the columns, and both ends of the range.
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


# Compiled evaluation of a joint surrogate: base plus weighted slices, at corresponding points.
#
# With w_j the weights of the slices along the effect, T_j the slices and B the base,
#
#     prediction = sum_j w_j T_j + (B - T_null)
#
# The slices of the sum are each taken at the point that corresponds to the query, where it lies between the same
# borders. The mesh's error, B - T_null, is taken at the query's own Ca, or at the border next to it, as it depends on
# the shape and some borders move far with an effect; near a limit of existence, at the same share of it. At the null
# value, where w is one for the null slice alone, the prediction is the base. Where base or null slice lack the branch,
# the prediction is that of the slices

_STEEP = 8  # power of the distance from the opposite border, with which points follow the upper border
_STEEP_BELOW = 16  # and the lower one: a division, from which the shape depends less on the distance than from a fold
_SQUEEZED = 0.9  # share of the range of Ca by which the borders may approach each other


class Stack(NamedTuple):
    """Tables of k surrogates, one after the other, branch by branch."""

    # Selecting one of an array of tables would cost as much as reading it.

    frames: Floats  # (2, k, 6): `BranchSurrogate.frame` of each branch
    rows: int  # number i of lattice points of a table along sqrt(Ca)
    coefficients: Floats  # (2 k i, j, 4, q)
    errors: Floats  # (2 k i, j, 3, 3): covariances without that in the gap between the branches
    differences: Floats  # of the difference from the null slice; for the base its mean square, which the mesh makes
    jumps: Floats  # in the gap alone
    borders: Floats  # (k, 3, c): lowest Ca, division, highest Ca in each column
    known: Booleans  # (2, k, c - 1): whether each surrogate has the branch between two columns


class Weighing(NamedTuple):
    """Weights of the k slices."""

    knots: Floats  # (k,): places of the slices along the effect
    null: int  # row of the null slice
    columns: Floats  # (c,): of a/l
    borders: Floats  # (k - 1, 4, 3, c): of the branches as functions of the effect, see `moving_borders`
    folds: Booleans  # (k - 1, c - 1): whether the highest Ca is a limit of existence for both slices and the base
    which: Integers  # (2, c - 1): row of the following arrays for each branch between two columns, -1 for none
    cubics: Floats  # (m, k - 1, ...), as the next two, see `CardinalCubics`
    left_out: Floats  # may have further rows, the error of the interpolation
    ends: Floats


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def located(ca, size, effect, weighing, position):  # type: ignore[no-untyped-def]
    """Return interval of the effect, branch, column and row of the weights for one point; row -1 outside the domain."""
    knots = weighing.knots
    if not (knots[0] <= effect <= knots[-1]):
        return 0, 0, 0, -1
    interval = 0
    while interval < len(knots) - 2 and effect >= knots[interval + 1]:
        interval += 1
    distance = effect - knots[interval]
    branch, column = place(ca, size, distance, weighing.columns, weighing.borders[interval], position)
    if branch < 0:
        return interval, 0, column, -1
    row = weighing.which[branch, column]
    if row >= 0 and np.isnan(weighing.ends[row, interval, 0]):
        if distance > 0.0 or interval == 0 or np.isnan(weighing.ends[row, interval - 1, 0]):
            return interval, branch, column, -1
        interval -= 1  # exactly on the last slice that has the branch
    return interval, branch, column, row


@njit(cache=True, nogil=True, error_model="numpy")
def covered(ca, size, effect, weighing):  # type: ignore[no-untyped-def]
    """Return whether each point lies in the domain : (n,) bool array."""
    inside, position = np.empty(len(ca), np.bool_), np.empty(4)
    for n in range(len(ca)):
        inside[n] = located(ca[n], size[n], effect[n], weighing, position)[3] >= 0
    return inside


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ends(j, branch, column, share, stack):  # type: ignore[no-untyped-def]
    """Return the lowest and the highest Ca of a branch of surrogate j, between two columns."""
    below, above = (1, 2) if branch == 0 else (0, 1)
    borders = stack.borders
    low = (1.0 - share) * borders[j, below, column] + share * borders[j, below, column + 1]
    high = (1.0 - share) * borders[j, above, column] + share * borders[j, above, column + 1]
    return low, high


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def moved_along(place, low, high, low_there, high_there):  # type: ignore[no-untyped-def]
    """Return the Ca between two borders there that corresponds to a place, 0 to 1, between two borders here."""
    # It is the same Ca except next to the borders, which it follows. It increases with the place; where the borders
    # there are too close together for that, the range is divided in the same ratio.
    width, first, last = high - low, low_there - low, high_there - high
    squeezed = max(first, 0.0) + max(-last, 0.0)
    if _STEEP_BELOW * squeezed <= _SQUEEZED * width:
        return low + place * width + first * _steep(1.0 - place) ** 2 + last * _steep(place)
    power = max(_SQUEEZED * width / squeezed, 1.0)
    below, above = min(power, _STEEP_BELOW), min(power, _STEEP)
    return low + place * width + first * (1.0 - place) ** below + last * place**above


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _steep(x):  # type: ignore[no-untyped-def]
    """Return x to the power of `_STEEP`, ten times faster than ``**``."""
    fourth = x * x * x * x
    return fourth * fourth


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _there(j, branch, column, position, stack):  # type: ignore[no-untyped-def]
    """Return the Ca of the corresponding point of surrogate j."""
    low, high = _ends(j, branch, column, position[1], stack)
    return moved_along(position[0], position[2], position[3], low, high)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _within_base(ca, distance, interval, branch, column, share, weighing, base, own):  # type: ignore[no-untyped-def]
    """Fill in the position (4,) of the query's own Ca between the borders of the base, or of the nearest border."""
    # Where a fold moves with the effect, the Ca of parachutes is taken relative to that of the fold.
    there = ca
    low, high = _ends(0, branch, column, share, base)
    if branch == 0 and weighing.folds[interval, column]:
        there *= high / border(weighing.borders[interval], 2, column, share, distance)
    own[0], own[1] = min(max((there - low) / max(high - low, 1e-300), 0.0), 1.0), share
    own[2], own[3] = low, high


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _read(j, branch, there, size, stack, value, no_slopes, error, difference, jump):  # type: ignore[no-untyped-def]
    """Fill in value (q,), error, difference and jump (3, 3) of surrogate j at a Ca."""
    frames, rows = stack.frames, stack.rows
    x = (np.sqrt(there) / frames[branch, j, 0] - frames[branch, j, 2]) / frames[branch, j, 4]
    y = (size / frames[branch, j, 1] - frames[branch, j, 3]) / frames[branch, j, 5]
    x = min(max(x, 0.0), rows - 1.000000001) + rows * (branch * frames.shape[1] + j)  # never in the next table
    hermite(x, y, stack.coefficients, value, no_slopes)
    bilinear(x, y, stack.errors, error)
    bilinear(x, y, stack.differences, difference)
    bilinear(x, y, stack.jumps, jump)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _apart(j, there, there_of_null, branch, column, share, stack, null):  # type: ignore[no-untyped-def]
    """Return the share, 0 to 1, of the error of slice j that has nothing to do with that of the null slice."""
    # It grows with the distance between the two places, of which cases lie about a step of the scaling apart, and with
    # the difference of what is left up to the upper border, next to which errors depend on it.
    root, root_of_null = np.sqrt(there), np.sqrt(there_of_null)
    left = np.sqrt(_ends(j, branch, column, share, stack)[1]) - root
    left_of_null = np.sqrt(_ends(null, branch, column, share, stack)[1]) - root_of_null
    unlike = (left - left_of_null) / max(left, left_of_null, 1e-12)
    return min(abs(root - root_of_null) / stack.frames[branch, null, 0] + unlike**2, 1.0)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _correspond(ca, size, effect, stack, base, weighing, position, own, places, weights, apart, every):  # type: ignore[no-untyped-def]
    """Return interval, branch and row of one point, see `located`, and whether the mesh is corrected there.

    Fill in Ca and weight (k + 2,) of what is added up: each slice, the null slice as it is subtracted, and the base;
    and the share (k,) of the error of a slice that has nothing to do with that of the null slice. Unless `every` is
    true, the Ca and the share of slices that do not count are left as they are.
    """
    count, null = len(weighing.knots), weighing.null
    interval, branch, column, row = located(ca, size, effect, weighing, position)
    if row < 0:
        return interval, branch, row, False
    distance, share = effect - weighing.knots[interval], position[1]
    corrected = base.known[branch, 0, column] and stack.known[branch, null, column]
    weights[count], weights[count + 1] = (-1.0, 1.0) if corrected else (0.0, 0.0)
    if corrected:
        _within_base(ca, distance, interval, branch, column, share, weighing, base, own)
        places[count] = _there(null, branch, column, own, stack)
        places[count + 1] = _there(0, branch, column, own, base)
    cubics, left_out = weighing.cubics[row, interval], weighing.left_out[row, interval]
    for j in range(count):
        weights[j] = cubics[0, j] + distance * (cubics[1, j] + distance * (cubics[2, j] + distance * cubics[3, j]))
        if every or weights[j] != 0.0 or left_out[:, j].any():
            places[j] = _there(j, branch, column, position, stack)
            if corrected:
                apart[j] = _apart(j, places[j], places[count], branch, column, share, stack, null)
    return interval, branch, row, corrected


@njit(cache=True, nogil=True, error_model="numpy")
def corresponding(ca, size, effect, stack, base, weighing, branches, places, weights, apart):  # type: ignore[no-untyped-def]
    """Fill in for each point its branch (n,), -1 outside, and what `_correspond` does, (n, k + 2) and (n, k)."""
    position, own, count, null = np.empty(4), np.empty(4), len(weighing.knots), weighing.null
    for n in range(len(ca)):
        _, branch, row, corrected = _correspond(
            ca[n], size[n], effect[n], stack, base, weighing, position, own, places[n], weights[n], apart[n], True
        )
        branches[n] = branch if row >= 0 else -1
        if corrected and abs(places[n, count] - places[n, null]) < 1e-12:  # one place: one evaluation, or none
            weights[n, null] -= 1.0
            weights[n, count] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(ca, size, effect, stack, base, weighing, values, covariance, inside):  # type: ignore[no-untyped-def]
    """Fill in the points of the domain: values (n, q), covariance (n, 3, 3), inside (n,)."""
    # The covariance is the sum of independent errors: those of the base; those of the slices with the squares of their
    # weights; that of the interpolation between the slices; and the change of the mesh error with the effect, as large
    # as that error itself at a distance from the null value of the whole range, or where it is taken a step of the
    # scaling from the query's own Ca, or between two Ca so far apart. What a slice shares with the null slice, which is
    # subtracted, cancels: its error is that of their difference, the more so the nearer to each other they are read. In
    # the gap between the branches of a slice, each is added the uncertainty of the branch; for the null slice it is
    # that of the base, since the mesh correction is one of a given branch.
    count, null, q = len(weighing.knots), weighing.null, values.shape[1]
    width = weighing.knots[-1] - weighing.knots[0]
    position, own, apart, no_slopes = np.empty(4), np.empty(4), np.ones(count), np.empty((0, 2))
    places, weights = np.empty(count + 2), np.empty(count + 2)
    of_slices, of_base, of_null = np.zeros((count, q)), np.empty(q), np.empty(q)
    error, difference, jump = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    error_of_null, of_mesh, of_gap = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(ca)):
        interval, branch, row, corrected = _correspond(
            ca[n], size[n], effect[n], stack, base, weighing, position, own, places, weights, apart, False
        )
        if row < 0:
            continue
        left_out, total = weighing.left_out[row, interval], covariance[n]
        values[n] = 0.0
        total[:] = 0.0
        of_null_left, beyond = -1.0, 0.0
        if corrected:
            there_of_null, there = places[count], places[count + 1]
            _read(null, branch, there_of_null, size[n], stack, of_null, no_slopes, error_of_null, difference, jump)
            _read(0, branch, there, size[n], base, of_base, no_slopes, total, of_mesh, of_gap)
            beyond = abs(np.sqrt(ca[n]) - np.sqrt(there)) + abs(np.sqrt(there) - np.sqrt(there_of_null))
            beyond = min(beyond / base.frames[branch, 0, 0], 1.0)
            values[n] = of_base - of_null
        for j in range(count):
            if weights[j] == 0.0 and not left_out[:, j].any():
                continue
            _read(j, branch, places[j], size[n], stack, of_slices[j], no_slopes, error, difference, jump)
            for k in range(q):
                values[n, k] += weights[j] * of_slices[j, k]
            shared = 1.0 - apart[j] if corrected else 0.0
            of_null_left += weights[j] * shared
            if corrected and j == null:
                jump[:] = of_gap
            for k in range(3):
                for m in range(3):
                    own_error = (1.0 - shared) * error[k, m] + shared * difference[k, m]
                    total[k, m] += weights[j] ** 2 * (own_error + jump[k, m])
        first, last = weighing.ends[row, interval]
        bump = 4.0 * (effect[n] - first) * (last - effect[n]) / (last - first) ** 2
        for missed in left_out:
            _add_missed(bump, missed, of_slices, total)
        if corrected:
            far = (effect[n] - weighing.knots[null]) / width
            for k in range(3):
                for m in range(3):
                    total[k, m] += far**2 * of_mesh[k, m] + of_null_left**2 * error_of_null[k, m]
                    total[k, m] += beyond**2 * (of_base[k] - of_null[k]) * (of_base[m] - of_null[m])
        values[n, 0] = max(values[n, 0], values[n, 1])  # an onset interpolated to within rounding
        inside[n] = True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_missed(factor, left_out, values, covariance):  # type: ignore[no-untyped-def]
    """Add the square of the interpolation error when one slice is left out."""
    x, y, z = 0.0, 0.0, 0.0
    for j in range(len(left_out)):
        share = factor * left_out[j]
        x, y, z = x + share * values[j, 0], y + share * values[j, 1], z + share * values[j, 2]
    missed = x, y, z
    for k in range(3):
        for m in range(3):
            covariance[k, m] += missed[k] * missed[m]


# Domain of existence of a joint surrogate: a part of the (Ca, a/l) plane for each value of the effect


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
        effect = self.place(coordinates[0] if coordinates else self.ends.null_value)
        ca, size, place = aligned(capillary_number, size_ratio, effect)
        return np.asarray(covered(ca, size, place, self.weighing), dtype=np.bool_)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        with np.errstate(divide="ignore"):
            boxes = [FixedDomain(self, value).bounds for value in self.scale.value(self.weighing.knots)]
        return (min(box[0][0] for box in boxes), max(box[0][1] for box in boxes)), boxes[0][1]

    def at(self, values: Mapping[str, float]) -> Domain:
        return FixedDomain(self, values[self.coordinate]) if self.coordinate in values else self

    def reason(self, capillary_number: float, size_ratio: float, **coordinates: float) -> str:
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
        del coordinates
        return self.whole.contains(capillary_number, size_ratio, self.value)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        borders, columns = self.whole.borders(self.value), self.whole.weighing.columns
        return (float(borders[0].min()), float(borders[2].max())), (float(columns[0]), float(columns[-1]))


# Surrogate with one more coordinate, the parameter that an effect database varies.
#
# It has one surrogate per value of the parameter, the *slices*, on a mesh that may be coarse, and a *base* surrogate on
# a finer mesh at the null value. The difference of the slices from the null slice is added to the base, so that the
# error of the coarse mesh is not mistaken for physics

SLICE_CELLS = (80, 60)  # a quarter of the memory of the base's tables; reading them takes most of the time

_STACKS: WeakKeyDictionary[PlaneSurrogate, Stack] = WeakKeyDictionary()  # of the bases


class EffectSurrogate(DatabaseModel):
    """Forward model (Ca, a/l, effect) -> (L_z, L_a, v_o/U, Lambda, outline), of a few values of one parameter.

    A slice is the surrogate of one value, and the base that of a finer mesh at the null value, or the null slice
    itself. The domain holds parachutes and convex shapes between the values that have them.
    """

    domain: EffectDomain

    def __init__(self, effect_database: Database, slices: tuple[PlaneSurrogate, ...], base: PlaneSurrogate) -> None:
        self.effect_database, self.slices, self.base = effect_database, slices, base
        database = effect_database
        if base.cross_section != database.dataset.attrs["cross_section"]:
            expected = f"a {database.dataset.attrs['cross_section']} cross-section"
            raise DatabaseError(f"base of {database.effect!r}: expected {expected}, got {base.name}")
        values, null = database.values, int(np.searchsorted(database.values, database.null_value))
        columns = _common_columns([*slices, base])
        borders = [Borders.of(surrogate, columns) for surrogate in slices]
        base_borders, borders[null] = matched(Borders.of(base, columns), borders[null])
        scale = SCALES.get(database.effect, LINEAR)
        with np.errstate(divide="ignore"):  # a scale may be a limit at an end
            knots = scale.place(values)
        moving = moving_borders(knots, borders, null, base_borders)
        limit = np.stack([each.limit for each in borders])
        limit = limit[1:] & limit[:-1] & base_borders.limit  # at both ends of an interval, and of the base
        folds = limit[:, 1:] & limit[:, :-1]
        weighing = Weighing(knots, null, columns, moving, folds, *_cardinal(values, knots, borders, scale))
        self.coordinate = database.effect
        ends = CoordinateRange(float(values[0]), float(values[-1]), database.null_value)
        self.name = f"{base.name} with {self.coordinate}"
        self.sha256 = hashlib.sha256(f"{base.sha256} {database.sha256}".encode()).hexdigest()
        self.domain = EffectDomain(weighing, scale, self.coordinate, ends)
        self.cross_section, self.view, self.database = base.cross_section, base.view, base.database
        self.coordinates = {self.coordinate: ends}
        self._stack = _stacked(slices, borders, null)
        self._base_stack = _shared(base, _stacked([base], [base_borders], 0))
        self._base_stack.differences[:] = self._mesh_differences()

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        self.check_names(theta)
        ca, size, place = self._points(theta)
        values, covariance = np.full((len(ca), len(NUMBERS)), np.nan), np.full((len(ca), 3, 3), np.nan)
        inside = np.zeros(len(ca), dtype=np.bool_)
        tables = self._stack, self._base_stack, self.domain.weighing
        evaluate(ca, size, place, *tables, values, covariance, inside)
        shapes = self._outlines(ca, size, place) if outline else None
        extent, length, velocity, stretch = values.T.copy()
        return Prediction(extent, length, velocity, stretch, covariance, inside, shapes)

    def outline_modes(self, **theta: float) -> Floats:
        # As in the covariance of a prediction: errors of the base, weighted errors of the slices, that of the
        # interpolation between the slices, and that of the mesh where it may change with the effect.
        self.check_names(theta)
        ca, size, effect = self._points(theta)
        weighing = self.domain.weighing
        interval, _, _, row = located(ca[0], size[0], effect[0], weighing, np.empty(4))
        if row < 0:
            raise self._outside(theta)
        branches, places, weights, apart = self._corresponding(ca, size, effect)
        normal = vertex_normals(self._outlines(ca, size, effect)[0])
        left_out, (first, last) = weighing.left_out[row, interval], weighing.ends[row, interval]
        corrected = weights[0, -1] != 0.0
        needed = (weights[0] != 0.0) | np.append(left_out.any(axis=0), [corrected, False])
        own, unlike, null = np.append(weights[0, :-2], [0.0, weights[0, -1]]), np.ones(len(needed)), None
        if corrected:
            null, unlike[:-2] = _part(self.slices[weighing.null], branches[0]), apart[0]
            own[weighing.null] += weights[0, -2] + 1.0
            own[-2] = own[:-2] @ (1.0 - unlike[:-2]) - 1.0
        modes, along = [], np.zeros((len(needed), len(normal)))
        for j in np.flatnonzero(needed):
            part = _part(self._surrogates[j], branches[0])
            along[j] = np.sum(part.outlines(places[:, j], size)[0] * normal, axis=1)
            for share, less in ((unlike[j], None), (1.0 - unlike[j], null)):
                if own[j] != 0.0 and share > 0.0:
                    modes.append(own[j] * share**0.5 * part.outline_modes(places[0, j], size[0], less))
        bump = 4.0 * (effect[0] - first) * (last - effect[0]) / (last - first) ** 2
        far = (effect[0] - weighing.knots[weighing.null]) / np.ptp(weighing.knots)
        if corrected:
            step = _part(self.base, branches[0]).scaling.ca_step
            beyond = np.abs(np.diff(np.sqrt([ca[0], places[0, -1], places[0, -2]]))).sum() / step
            far = np.hypot(far, min(beyond, 1.0))
        return np.concatenate([*modes, bump * left_out @ along[:-2], far * (along[-1] - along[-2])[None]])

    def case_caveats(self, points: Mapping[str, Floats]) -> dict[str, Booleans]:
        # Those of the two slices next to each point, at the points of these that correspond to it.
        ca, size, place = self._points(points)
        knots, rows = self.domain.weighing.knots, np.arange(len(ca))
        branches, there, *_ = self._corresponding(ca, size, place)
        there[branches < 0] = ca[branches < 0, None]
        pairs = zip(self.slices, there.T, strict=False)  # of the further columns none is a slice's own
        each = [one.case_caveats({"capillary_number": column, "size_ratio": size}) for one, column in pairs]
        below = np.clip(np.searchsorted(knots, place, side="right") - 1, 0, len(knots) - 2)
        combined = {}
        for kind in sorted({kind for caveats in each for kind in caveats}):
            of_slice = np.stack([caveats.get(kind, np.zeros(len(ca), dtype=np.bool_)) for caveats in each])
            combined[kind] = of_slice[below, rows] | (of_slice[below + 1, rows] & (place > knots[below]))
        return combined

    def _points(self, theta: Mapping[str, ArrayLike]) -> list[Floats]:
        effect = self.domain.place(theta.get(self.coordinate, self.domain.ends.null_value))
        return aligned(theta["capillary_number"], theta["size_ratio"], effect)

    @property
    def _surrogates(self) -> list[PlaneSurrogate]:
        """Slices, null slice as it is subtracted, base."""
        return [*self.slices, self.slices[self.domain.weighing.null], self.base]

    def _corresponding(self, ca: Floats, size: Floats, effect: Floats) -> tuple[Integers, Floats, Floats, Floats]:
        """Return the branch (n,), the Ca and the weight (n, k + 2) of each of `_surrogates`, see `corresponding`."""
        branches, weights = np.empty(len(ca), np.int64), np.zeros((len(ca), len(self.slices) + 2))
        places, apart = np.empty_like(weights), np.ones((len(ca), len(self.slices)))
        tables = self._stack, self._base_stack, self.domain.weighing
        corresponding(ca, size, effect, *tables, branches, places, weights, apart)
        return branches, places, weights, apart

    def _mesh_differences(self) -> Floats:
        """Return on the table's lattices of the base the mean square of its difference from the null slice."""
        null = self.slices[self.domain.weighing.null]
        covariance = np.full((len(BRANCHES), *(count + 1 for count in self.base.cells), 3, 3), np.nan)
        for part in self.base.branches:
            k, rows = BRANCHES.index(part.branch.name), part.branch.rows
            ca, size = part.cases["capillary_number"][rows], part.cases["size_ratio"][rows]
            place = np.full(len(ca), self.domain.weighing.knots[self.domain.weighing.null])
            branches, places, weights, _ = self._corresponding(ca, size, place)
            both = np.flatnonzero((branches == k) & (weights[:, -1] != 0.0))
            if len(both) > 1:
                there = _part(null, k).values_at(places[both, -2], size[both])
                of_mesh = part.values_at(places[both, -1], size[both]) - there
                covariance[k] = part.on_lattice(OwnError(part.approximation.nodes[both], of_mesh))
        return covariance.reshape(-1, *covariance.shape[2:])

    def _outlines(self, ca: Floats, size: Floats, effect: Floats) -> Floats:
        branches, places, weights, _ = self._corresponding(ca, size, effect)
        outlines = np.full((len(ca), self.effect_database.dataset.sizes["point"], 2), np.nan)
        outlines[branches >= 0] = 0.0
        for j, surrogate in enumerate(self._surrogates):
            for part in surrogate.branches:
                here = np.flatnonzero((branches == BRANCHES.index(part.branch.name)) & (weights[:, j] != 0.0))
                if len(here):
                    outlines[here] += weights[here, j, None, None] * part.outlines(places[here, j], size[here])
        return outlines


def _part(surrogate: PlaneSurrogate, branch: int) -> BranchSurrogate:
    return next(part for part in surrogate.branches if part.branch.name == BRANCHES[branch])


def check_values(database: Database) -> None:
    """Refuse an effect database whose values do not make a coordinate."""
    values = database.values
    if len(values) < FEWEST_KNOTS or database.null_value not in values:
        expected = f"at least {FEWEST_KNOTS} values of {database.effect}, {database.null_value:g} among them"
        raise DatabaseError(f"effect database: expected {expected}, got {', '.join(f'{value:g}' for value in values)}")


def _common_columns(surrogates: list[PlaneSurrogate]) -> Floats:
    """Return every column of a/l of any surrogate that lies within the columns of all of them."""
    regions = [[part.branch.region.size_ratio for part in each.branches] for each in surrogates]
    first = max(min(columns[0] for columns in several) for several in regions)
    last = min(max(columns[-1] for columns in several) for several in regions)
    every = np.unique(np.round(np.concatenate([columns for several in regions for columns in several]), 6))
    return every[(every >= first - 1e-9) & (every <= last + 1e-9)]


def _cardinal(
    values: Floats, knots: Floats, borders: list[Borders], scale: Scale
) -> tuple[Integers, Floats, Floats, Floats]:
    """Return the row of weights of each branch between two columns, and the weights of each set of known slices."""
    known = np.stack([each.known for each in borders], axis=-1)  # (branch, column, slice)
    enough = known.sum(axis=-1) >= FEWEST_KNOTS
    sets, which = np.unique(known[enough], axis=0, return_inverse=True)
    cardinal = [CardinalCubics(knots, some) for some in sets]
    rows = np.full(enough.shape, -1, dtype=np.int64)
    rows[enough] = np.ravel(which)
    names = ("cubics", "left_out", "ends")
    cubics, left_out, ends = (np.stack([getattr(each, name) for each in cardinal]) for name in names)
    if scale.approximate:  # twice the difference: simulated transients differ by up to that
        middle = (knots[1:] + knots[:-1]) / 2
        linear = [CardinalCubics(values, some) for some in sets]
        other = [
            [2.0 * (plain.weights(float(scale.value(place))) - curved.weights(place)) for place in middle]
            for plain, curved in zip(linear, cardinal, strict=True)
        ]
        left_out = np.concatenate([left_out, np.nan_to_num(other)[:, :, None]], axis=2)
    return rows, cubics, left_out, ends


def _shared(base: PlaneSurrogate, stack: Stack) -> Stack:
    """Return the stack of a base with the tables that are the same for all effects on it."""
    first = _STACKS.setdefault(base, stack)
    return stack._replace(coefficients=first.coefficients, errors=first.errors, jumps=first.jumps)


def _stacked(surrogates: Sequence[PlaneSurrogate], borders: Sequence[Borders], null: int) -> Stack:
    cells = tuple(count + 1 for count in surrogates[0].cells)
    shape = (len(BRANCHES), len(surrogates))
    frames = np.ones((*shape, 6))
    coefficients = np.full((*shape, *cells, 4, len(NUMBERS)), np.nan)
    errors, differences, jumps = np.full((3, *shape, *cells, 3, 3), np.nan)
    of_null = {part.branch.name: part for part in surrogates[null].branches}
    for j, surrogate in enumerate(surrogates):
        for part in surrogate.branches:
            k = BRANCHES.index(part.branch.name)
            frames[k, j], errors[k, j] = part.frame, part.lattice_covariance - part.lattice_jump
            jumps[k, j] = part.lattice_jump
            if part.branch.name in of_null:
                differences[k, j] = part.difference_covariance(of_null[part.branch.name])
            coefficients[k, j] = part.table.coefficients
    tables = coefficients, errors, differences, jumps
    coefficients, errors, differences, jumps = (table.reshape(-1, *table.shape[3:]) for table in tables)
    lines = np.stack([each.capillary_number for each in borders])
    known = np.stack([each.known for each in borders], axis=1)
    return Stack(frames, cells[0], coefficients, errors, differences, jumps, lines, known)
