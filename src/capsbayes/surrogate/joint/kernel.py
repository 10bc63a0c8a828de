"""Compiled evaluation of a joint surrogate: base plus weighted slices, at corresponding points.

With w_j the weights of the slices along the effect, T_j the slices and B the
base,

    prediction = sum_j w_j T_j + (B - T_null)

The slices of the sum are each taken at the point that corresponds to the query,
where it lies between the same borders. The mesh's error, B - T_null, is taken at
the query's own Ca, or at the border next to it, as it depends on the shape and
some borders move far with an effect; near a limit of existence, at the same
share of it. At the null value, where w is one for the
null slice alone, the prediction is the base. Where base or null slice lack
the branch, the prediction is that of the slices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.surrogate.branch_surrogate import bilinear
from capsbayes.surrogate.joint.correspondence import border, place
from capsbayes.surrogate.table import hermite

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
def _weigh(effect, interval, row, weighing, weights):  # type: ignore[no-untyped-def]
    """Fill in the weights (k,) of the slices."""
    distance = effect - weighing.knots[interval]
    cubics = weighing.cubics[row, interval]
    for j in range(len(weights)):
        weights[j] = cubics[0, j] + distance * (cubics[1, j] + distance * (cubics[2, j] + distance * cubics[3, j]))


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
    """Return the Ca between two borders there that corresponds to a place, 0 to 1, between two borders here.

    It is the same Ca except next to the borders, which it follows. It increases with the place; where the borders
    there are too close together for that, the range is divided in the same ratio.
    """
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
    """Fill in the position (4,) of the query's own Ca between the borders of the base, or of the nearest border.

    Where a fold moves with the effect, the Ca of parachutes is taken relative to that of the fold.
    """
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
    """Return the share, 0 to 1, of the error of slice j that has nothing to do with that of the null slice.

    It grows with the distance between the two places, of which cases lie about a step of the scaling apart, and with
    the difference of what is left up to the upper border, next to which errors depend on it.
    """
    root, root_of_null = np.sqrt(there), np.sqrt(there_of_null)
    left = np.sqrt(_ends(j, branch, column, share, stack)[1]) - root
    left_of_null = np.sqrt(_ends(null, branch, column, share, stack)[1]) - root_of_null
    unlike = (left - left_of_null) / max(left, left_of_null, 1e-12)
    return min(abs(root - root_of_null) / stack.frames[branch, null, 0] + unlike**2, 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def corresponding(ca, size, effect, stack, base, weighing, branches, places, weights, apart):  # type: ignore[no-untyped-def]
    """Fill in for each point its branch (n,), -1 outside, and Ca and weight (n, k + 2) of what is added up.

    These are each slice, the null slice as it is subtracted, and the base. `apart` (n, k) is the share of the error of
    a slice that has nothing to do with that of the null slice.
    """
    position, own, count = np.empty(4), np.empty(4), len(weighing.knots)
    for n in range(len(ca)):
        interval, branch, column, row = located(ca[n], size[n], effect[n], weighing, position)
        branches[n] = branch if row >= 0 else -1
        if row < 0:
            continue
        _weigh(effect[n], interval, row, weighing, weights[n, :count])
        for j in range(count):
            places[n, j] = _there(j, branch, column, position, stack)
        corrected = base.known[branch, 0, column] and stack.known[branch, weighing.null, column]
        distance = effect[n] - weighing.knots[interval]
        _within_base(ca[n], distance, interval, branch, column, position[1], weighing, base, own)
        places[n, count] = _there(weighing.null, branch, column, own, stack)
        places[n, count + 1] = _there(0, branch, column, own, base)
        weights[n, count] = -1.0 if corrected else 0.0
        weights[n, count + 1] = 1.0 if corrected else 0.0
        for j in range(count):
            apart[n, j] = _apart(j, places[n, j], places[n, count], branch, column, position[1], stack, weighing.null)
        if corrected and abs(places[n, count] - places[n, weighing.null]) < 1e-12:  # one place: one evaluation, or none
            weights[n, weighing.null] -= 1.0
            weights[n, count] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(ca, size, effect, stack, base, weighing, values, covariance, inside):  # type: ignore[no-untyped-def]
    """Fill in the points of the domain: values (n, q), covariance (n, 3, 3), inside (n,).

    The covariance is the sum of independent errors: those of the base; those of
    the slices with the squares of their weights; that of the interpolation
    between the slices; and the change of the mesh error with the effect, as
    large as that error itself at a distance from the null value of the whole
    range, or where it is taken a step of the scaling from the query's own Ca, or
    between two Ca so far apart.
    What a slice shares with the null slice, which is subtracted, cancels: its
    error is that of their difference, the more so the nearer to each other they
    are read. In the gap between the branches of a slice, each is added the
    uncertainty of the branch; for the null slice it is that of the base, since the
    mesh correction is one of a given branch.
    """
    count, null, q = len(weighing.knots), weighing.null, values.shape[1]
    width = weighing.knots[-1] - weighing.knots[0]
    position, own, weights, no_slopes = np.empty(4), np.empty(4), np.empty(count), np.empty((0, 2))
    of_slices, of_base, of_null = np.zeros((count, q)), np.empty(q), np.empty(q)
    error, difference, jump = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    error_of_null, of_mesh, of_gap = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(ca)):
        interval, branch, column, row = located(ca[n], size[n], effect[n], weighing, position)
        if row < 0:
            continue
        _weigh(effect[n], interval, row, weighing, weights)
        left_out, total = weighing.left_out[row, interval], covariance[n]
        values[n] = 0.0
        total[:] = 0.0
        corrected = base.known[branch, 0, column] and stack.known[branch, null, column]
        there_of_null, of_null_left, beyond = 0.0, -1.0, 0.0
        if corrected:
            distance = effect[n] - weighing.knots[interval]
            _within_base(ca[n], distance, interval, branch, column, position[1], weighing, base, own)
            there_of_null = _there(null, branch, column, own, stack)
            _read(null, branch, there_of_null, size[n], stack, of_null, no_slopes, error_of_null, difference, jump)
            there = _there(0, branch, column, own, base)
            beyond = abs(np.sqrt(ca[n]) - np.sqrt(there)) + abs(np.sqrt(there) - np.sqrt(there_of_null))
            beyond = min(beyond / base.frames[branch, 0, 0], 1.0)
            _read(0, branch, there, size[n], base, of_base, no_slopes, total, of_mesh, of_gap)
            values[n] = of_base - of_null
        for j in range(count):
            if weights[j] == 0.0 and not left_out[:, j].any():
                continue
            there = _there(j, branch, column, position, stack)
            _read(j, branch, there, size[n], stack, of_slices[j], no_slopes, error, difference, jump)
            for k in range(q):
                values[n, k] += weights[j] * of_slices[j, k]
            apart = 1.0
            if corrected:
                apart = _apart(j, there, there_of_null, branch, column, position[1], stack, null)
                of_null_left += weights[j] * (1.0 - apart)
                if j == null:
                    jump[:] = of_gap
            for k in range(3):
                for m in range(3):
                    own_error = apart * error[k, m] + (1.0 - apart) * difference[k, m]
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
    missed = (0.0, 0.0, 0.0)
    for j in range(len(left_out)):
        share = factor * left_out[j]
        missed = (
            missed[0] + share * values[j, 0],
            missed[1] + share * values[j, 1],
            missed[2] + share * values[j, 2],
        )
    for k in range(3):
        for m in range(3):
            covariance[k, m] += missed[k] * missed[m]
