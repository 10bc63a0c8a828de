"""Profiles of intensity along the normals of a closed curve, and what their arcs have in common; compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def sampled(spline, points, normals, samples):  # type: ignore[no-untyped-def]
    """Return a picture at distances inwards from points along their normals : (n, m) array.

    The picture is given by the coefficients of its cubic spline (rows, columns), mirrored at its borders, beyond which
    it stays as it is there. The points and the unit vectors outwards are (n, 2) arrays, the distances an array (m,).
    """
    rows, columns = spline.shape
    values = np.empty((len(points), len(samples)))
    by_row, by_column = np.empty(4), np.empty(4)
    for n in range(len(points)):
        for i in range(len(samples)):
            row = min(max(points[n, 1] - samples[i] * normals[n, 1], 0.0), rows - 1.0)
            column = min(max(points[n, 0] - samples[i] * normals[n, 0], 0.0), columns - 1.0)
            upper, left = int(row), int(column)
            _weights(row - upper, by_row)
            _weights(column - left, by_column)
            total = 0.0
            for a in range(4):
                r = _mirrored(upper + a - 1, rows)
                for b in range(4):
                    total += by_row[a] * by_column[b] * spline[r, _mirrored(left + b - 1, columns)]
            values[n, i] = total
    return values


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t, weights):  # type: ignore[no-untyped-def]
    """Fill in the weights (4,) of the coefficients around a place, a distance t in (0, 1) behind the second."""
    weights[0] = (1.0 - t) ** 3 / 6.0
    weights[1] = (3.0 * t - 6.0) * t * t / 6.0 + 2.0 / 3.0
    weights[2] = ((3.0 - 3.0 * t) * t + 3.0) * t / 6.0 + 1.0 / 6.0
    weights[3] = t**3 / 6.0


@njit(cache=True, nogil=True, error_model="numpy")
def _mirrored(index, count):  # type: ignore[no-untyped-def]
    return abs(index) if index < count else 2 * (count - 1) - index


@njit(cache=True, nogil=True, error_model="numpy")
def means_of_arcs(profiles, arc, arcs):  # type: ignore[no-untyped-def]
    """Return the mean of the profiles (n, m) of each arc : (arcs, m) array, and their numbers : (arcs,) array.

    The number of the arc of each profile rises along the curve.
    """
    means, count = np.zeros((arcs, profiles.shape[1])), np.zeros(arcs)
    for n in range(len(profiles)):
        count[arc[n]] += 1.0
        for i in range(profiles.shape[1]):
            means[arc[n], i] += profiles[n, i]
    for a in range(arcs):
        for i in range(profiles.shape[1]):
            means[a, i] /= count[a]
    return means, count


@njit(cache=True, nogil=True, error_model="numpy")
def mean_squares(profiles, means, arc, used):  # type: ignore[no-untyped-def]
    """Return the mean square of the difference of profiles (n, m) from their arc's (arcs, m), where it is used : (n,).

    The numbers `used` (arcs, m) are 1 or 0.
    """
    squares = np.zeros(len(profiles))
    for n in range(len(profiles)):
        a, count = arc[n], 0.0
        for i in range(profiles.shape[1]):
            squares[n] += used[a, i] * (profiles[n, i] - means[a, i]) ** 2
            count += used[a, i]
        squares[n] /= count
    return squares


@njit(cache=True, nogil=True, error_model="numpy")
def misfit_around(left, used, place_variance, fitted, neighbours):  # type: ignore[no-untyped-def]
    """Return the error of the place of each arc that follows from what the model leaves over : (arcs,) array.

    What is left (arcs, m) has few degrees of freedom, as so many parameters are fitted: those of the neighbours to
    either side, around the closed curve, are added to them.
    """
    arcs = len(left)
    squares, free = np.zeros(arcs), np.zeros(arcs)
    for a in range(arcs):
        for i in range(left.shape[1]):
            squares[a] += used[a, i] * left[a, i] ** 2
            free[a] += used[a, i]
        free[a] = max(free[a] - fitted, 0.0)
    misfit = np.empty(arcs)
    for a in range(arcs):
        total, degrees = 0.0, 0.0
        for b in range(a - neighbours, a + neighbours + 1):
            total += squares[b % arcs]
            degrees += free[b % arcs]
        misfit[a] = np.sqrt(total / max(degrees, 1.0) * place_variance[a])
    return misfit


@njit(cache=True, nogil=True, error_model="numpy")
def tangents(base):  # type: ignore[no-untyped-def]
    """Return the unit tangents of a closed curve of points at equal distances : (n, 2) arrays."""
    count = len(base)
    made = np.empty((count, 2))
    for n in range(count):
        before, after = base[n - 1], base[(n + 1) % count]
        x, y = after[0] - before[0], after[1] - before[1]
        length = np.hypot(x, y)
        made[n, 0], made[n, 1] = x / length, y / length
    return made


@njit(cache=True, nogil=True, error_model="numpy")
def curvatures(curve):  # type: ignore[no-untyped-def]
    """Return the curvature at each of the points (n, 2) at equal distances on a closed curve, clockwise in a picture.

    It is positive where the curve is convex.
    """
    count = len(curve)
    made = np.empty(count)
    for n in range(count):
        before, here, after = curve[n - 1], curve[n], curve[(n + 1) % count]
        x, y = 0.5 * (after[0] - before[0]), 0.5 * (after[1] - before[1])
        bent_x, bent_y = after[0] - 2.0 * here[0] + before[0], after[1] - 2.0 * here[1] + before[1]
        made[n] = (x * bent_y - y * bent_x) / np.hypot(x, y) ** 3
    return made


@njit(cache=True, nogil=True, error_model="numpy")
def rounded(curve, deviation):  # type: ignore[no-untyped-def]
    """Return a closed curve (n, 2) smoothed by a Gaussian of a standard deviation in points, cut off at four of it."""
    reach, count = int(4.0 * deviation + 0.5), len(curve)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    weights /= weights.sum()
    smooth = np.zeros(curve.shape)
    for n in range(count):
        at = (n - reach) % count
        for i in range(len(weights)):
            for axis in range(2):
                smooth[n, axis] += weights[i] * curve[at, axis]
            at += 1
            if at == count:
                at = 0
    return smooth
