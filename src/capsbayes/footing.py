"""Measured outlines on other ones: their normal distances, and those from their own mirror image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from capsbayes.arrays import Floats
from capsbayes.profile import edge_lengths

# Normal distances between a measured outline and predicted ones

_FITS = 5  # of the pose; three suffice from half a radius away
_STANDS = 1e-4  # shift and turn that are neglected where many outlines are compared
_DAMPED = 1e-3  # mean square change by a turn, below which it is damped: a circle has no tilt


class Footing(NamedTuple):
    """Nearest places of measured points (m, 2) on one outline."""

    distance: Floats  # (m,): normal distance, positive outside
    place: Floats  # (m,): number of the vertex before the nearest point, and the share of the edge from there on
    normal: Floats  # (m, 2): outward unit normal there


def posed_on(points: Floats, outline: Floats, *, fits: int = _FITS) -> tuple[Floats, Footing]:
    """Shift and turn points onto one closed outline by least squares, and find their nearest places on it."""
    moved, count = np.array(points, dtype=np.float64, order="C"), len(points)
    distance, place, normal = np.empty(count), np.empty(count), np.empty((count, 2))
    _pose(moved, _contiguous(outline), fits, 0.0, distance, place, normal)
    return moved, Footing(distance, place, normal)


def normal_distances(points: Floats, outlines: Floats, *, posed: bool = False) -> Floats:
    """Return the normal distances of measured points from each of n outlines, positive outside."""
    distances = np.empty((len(outlines), len(points)))
    _all_distances(_contiguous(points), _contiguous(outlines), _FITS if posed else 0, distances)
    return distances


def _contiguous(array: Floats) -> Floats:
    return np.ascontiguousarray(array, dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def _all_distances(points, outlines, fits, distances):  # type: ignore[no-untyped-def]
    moved, place, normal = np.empty_like(points), np.empty(len(points)), np.empty((len(points), 2))
    for n in range(len(outlines)):
        if np.isnan(outlines[n, 0, 0]):
            distances[n] = np.nan
            continue
        for i in range(len(points)):  # numba takes seconds to compile an assignment of arrays
            moved[i, 0], moved[i, 1] = points[i, 0], points[i, 1]
        _pose(moved, outlines[n], fits, _STANDS, distances[n], place, normal)


@njit(cache=True, nogil=True, error_model="numpy")
def _pose(points, outline, fits, stands, distance, place, normal):  # type: ignore[no-untyped-def]
    """Shift and turn points in place, a few times or until nothing changes, and find their nearest places."""
    _nearest(points, outline, distance, place, normal)
    for _ in range(fits):
        if not _moved(points, stands, distance, normal):
            break
        _nearest(points, outline, distance, place, normal)


@njit(cache=True, nogil=True, error_model="numpy")
def _moved(points, stands, distance, normal):  # type: ignore[no-untyped-def]
    """Shift and turn points by least squares of their distances, in place; False if they stand well."""
    matrix, side, row = np.zeros((3, 3)), np.zeros(3), np.empty(3)
    for i in range(len(points)):
        row[0], row[1] = normal[i, 0], normal[i, 1]
        row[2] = points[i, 0] * normal[i, 1] - points[i, 1] * normal[i, 0]
        for j in range(3):
            side[j] -= row[j] * distance[i]
            for k in range(3):
                matrix[j, k] += row[j] * row[k]
    matrix[2, 2] += _DAMPED * len(points)
    step = np.linalg.solve(matrix, side)
    if max(abs(step[0]), abs(step[1]), abs(step[2])) < stands:
        return False
    cosine, sine = np.cos(step[2]), np.sin(step[2])
    for i in range(len(points)):
        z, y = points[i]
        points[i, 0], points[i, 1] = cosine * z - sine * y + step[0], sine * z + cosine * y + step[1]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(points, outline, distance, place, normal):  # type: ignore[no-untyped-def]
    """Fill in distance, place and normal of each point: the first looks everywhere, the others near the one before.

    So no point jumps from the outer side of a thin rim to its inner side. Behind a gap, as left where a wall hid the
    edge, it is looked for as much further on.
    """
    count = len(outline)
    round_it, longest = 0.0, 0.0
    for j in range(count):
        following = j + 1 if j + 1 < count else 0
        along_z, along_y = outline[following, 0] - outline[j, 0], outline[following, 1] - outline[j, 1]
        edge_length = np.sqrt(along_z * along_z + along_y * along_y)
        round_it += edge_length
        longest = max(longest, edge_length)
    squares = np.empty(count)
    usual, best = min(count, 8 + 6 * count // len(points)), 0
    for i in range(len(points)):
        z, y = points[i]
        reach = usual
        if i == 0:
            reach = count
        else:
            step = np.hypot(z - points[i - 1, 0], y - points[i - 1, 1]) / round_it * count
            if 2.0 * step > usual - 8:
                reach = min(count, usual + int(3.0 * step))
        first = best - reach // 2
        if first < 0:  # the modulo operator would take longer than all the rest
            first += count
        square, j = np.inf, first
        for k in range(reach):
            away_z, away_y = z - outline[j, 0], y - outline[j, 1]
            squares[k] = away_z * away_z + away_y * away_y
            square = min(square, squares[k])
            j = j + 1 if j + 1 < count else 0
        # an edge is nearer than its vertex by its length at most
        farthest, edge, share, j = (np.sqrt(square) + longest) ** 2, 0, 0.0, first
        square = np.inf
        for k in range(reach):
            following = j + 1 if j + 1 < count else 0
            if squares[k] <= farthest:
                z0, y0 = outline[j]
                along_z, along_y = outline[following, 0] - z0, outline[following, 1] - y0
                length = along_z * along_z + along_y * along_y
                t = min(max(((z - z0) * along_z + (y - y0) * along_y) / max(length, 1e-300), 0.0), 1.0)
                away_z, away_y = z - z0 - t * along_z, y - y0 - t * along_y
                found = away_z * away_z + away_y * away_y
                if found < square:
                    square, edge, share = found, j, t
            j = following
        _normal_at(outline, edge, share, normal[i])
        foot_z = outline[edge, 0] + share * (outline[(edge + 1) % count, 0] - outline[edge, 0])
        foot_y = outline[edge, 1] + share * (outline[(edge + 1) % count, 1] - outline[edge, 1])
        outward = (z - foot_z) * normal[i, 0] + (y - foot_y) * normal[i, 1]
        distance[i] = np.sqrt(square) if outward >= 0.0 else -np.sqrt(square)
        place[i] = edge + share
        best = edge


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _normal_at(outline, edge, share, out):  # type: ignore[no-untyped-def]
    """Interpolate the outward unit normal along an edge between those of its two vertices."""
    count = len(outline)
    before, after, next_after = (edge - 1) % count, (edge + 1) % count, (edge + 2) % count
    # the normal of a vertex is that of the chord between its neighbours
    start_z, start_y = outline[after, 1] - outline[before, 1], outline[before, 0] - outline[after, 0]
    end_z, end_y = outline[next_after, 1] - outline[edge, 1], outline[edge, 0] - outline[next_after, 0]
    z, y = (1.0 - share) * start_z + share * end_z, (1.0 - share) * start_y + share * end_y
    size = np.sqrt(z * z + y * y)
    out[0], out[1] = z / size, y / size


# The odd part of an outline, by which it is not symmetric about the flow

_LAID = 3  # times that an outline with a gap is laid onto its mirror image
_GAP = 3.0  # median distances of points: behind a longer edge, a wall hid the outline


def on_mirror(points: Floats) -> tuple[Floats, float]:
    """Return the odd part of an outline about its own axis, at its points along their normals, and the axis' angle.

    The axis is that about which it is most symmetric, the angle that from z [rad]. Laid onto its mirror image, an
    outline is twice its odd part away from it, and turned by twice the angle.
    """
    mirrored = points[::-1] * [1.0, -1.0]
    near = points - 0.5 * (points.max(axis=0) + points.min(axis=0)) * [0.0, 2.0]
    edges = edge_lengths(mirrored)
    hidden = edges > _GAP * np.median(edges)
    seen = np.ones(len(points), dtype=bool)
    for _ in range(_LAID if hidden.any() else 1):  # points whose image is hidden would pull it aside
        laid = near[seen]
        moved, feet = posed_on(laid, mirrored)
        distance = np.full(len(points), np.nan)
        distance[seen] = np.where(hidden[feet.place.astype(int) % len(mirrored)], np.nan, feet.distance)
        seen = np.isfinite(distance)
    before, after = (each @ [1.0, 1j] for each in (laid - laid.mean(axis=0), moved - moved.mean(axis=0)))
    return 0.5 * distance, -0.5 * float(np.angle(np.vdot(before, after)))
