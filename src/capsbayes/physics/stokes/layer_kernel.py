"""Compiled matrices of the single layer on a symmetric P2 surface.

Quadrature points lie in tiles of 64: a flat block of seven rows, the three
coordinates, the weight, and the three components of the density. All offsets
within a block are constants, which lets the compiler prove that rows do not
overlap and work on many points at once.

Only one element of each orbit is summed over. Instead of its images,
the target is rotated back: with an operation g,
G(x, g y) g f = g G(g^T x, y) f.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from capsbayes.arrays import Floats, Integers

TILE = 64
"""Quadrature points in a tile."""

POINT_ROWS = 7
"""Rows of a tile's block."""

_BLOCK = POINT_ROWS * TILE

_compiled = numba.njit(cache=True, fastmath=True, error_model="numpy", nogil=True)
_in_order = numba.njit(cache=True, error_model="numpy", nogil=True)
"""Of sums over points: free to reorder them, LLVM does so where the arrays happen to lie far enough apart in memory."""


class Elements(NamedTuple):
    """One element of each orbit, and the action of the group."""

    nodes: Integers  # (e, 6)
    wedge_of: Integers  # (N,): position of each node among the unknown nodes
    operation: Floats  # (N, 3, 3): the operation from the unknown node onto the node
    images: Integers  # (g, N): the node that each operation of the group maps onto each node
    turns: Floats  # (g, 3, 3): the operations of the group, which preserve the axis z
    centres: Floats  # (e, 3): with the radii (e,) a ball around each element, which decides the rule
    radii: Floats


class Tiles(NamedTuple):
    """Quadrature points of all rules."""

    levels: Floats  # (m,): falling ratios of distance to radius; rule i serves those above levels[i], rule m the rest
    coarse: Floats  # (b * 448,): blocks of rule 0, each of as many whole elements as fit
    coarse_shapes: Floats  # (q, 8): shape functions of rule 0, and two columns of zeros that complete the vectors
    fine: Floats  # (e * c * 448,): blocks of the rules 1 to m and of the six singular at a node, of each element
    fine_shapes: Floats  # (c * 6 * 64,): shape functions at their points
    first: Integers  # (m + 7,): first block of each of these rules among the c of an element
    counts: Integers  # (m + 6,): number of its points


@_compiled
def _stokeslet(r0: float, r1: float, r2: float, weight: float) -> tuple[float, ...]:
    """Return the six entries of the weighted Stokeslet, upper triangle row by row, then weight / r^3 and 1 / r^2."""
    square = 1.0 / (r0 * r0 + r1 * r1 + r2 * r2)
    i1 = weight * np.sqrt(square)
    i3 = i1 * square
    return i1 + r0 * r0 * i3, r0 * r1 * i3, r0 * r2 * i3, i1 + r1 * r1 * i3, r1 * r2 * i3, i1 + r2 * r2 * i3, i3, square


@_compiled
def _derivative(
    r0: float, r1: float, r2: float, f0: float, f1: float, f2: float, i3: float, square: float
) -> tuple[float, ...]:
    """Return the nine derivatives of the velocity of a force f along the target, entry 3 i + j that of v_i along j."""
    a = (r0 * f0 + r1 * f1 + r2 * f2) * i3
    b = 3.0 * a * square
    c0, c1, c2 = b * r0, b * r1, b * r2
    t01, t02, t12 = (r0 * f1 - f0 * r1) * i3, (r0 * f2 - f0 * r2) * i3, (r1 * f2 - f1 * r2) * i3
    return (
        a - c0 * r0,
        t01 - c0 * r1,
        t02 - c0 * r2,
        -t01 - c1 * r0,
        a - c1 * r1,
        t12 - c1 * r2,
        -t02 - c2 * r0,
        -t12 - c2 * r1,
        a - c2 * r2,
    )


@_compiled
def _fill(x: Floats, points: Floats, base: int, count: int, kernel: Floats, with_slope: bool) -> None:
    """Fill rows of 64 with the weighted Stokeslets (6) and the derivatives of their velocity (9), seen from `x`."""
    x0, x1, x2 = x[0], x[1], x[2]
    for q in range(count):
        p = base + q
        r0, r1, r2 = x0 - points[p], x1 - points[p + 64], x2 - points[p + 128]
        g00, g01, g02, g11, g12, g22, i3, square = _stokeslet(r0, r1, r2, points[p + 192])
        kernel[q] = g00
        kernel[64 + q] = g01
        kernel[128 + q] = g02
        kernel[192 + q] = g11
        kernel[256 + q] = g12
        kernel[320 + q] = g22
        if with_slope:
            f0, f1, f2 = points[p + 256], points[p + 320], points[p + 384]
            d00, d01, d02, d10, d11, d12, d20, d21, d22 = _derivative(r0, r1, r2, f0, f1, f2, i3, square)
            kernel[384 + q] = d00
            kernel[448 + q] = d01
            kernel[512 + q] = d02
            kernel[576 + q] = d10
            kernel[640 + q] = d11
            kernel[704 + q] = d12
            kernel[768 + q] = d20
            kernel[832 + q] = d21
            kernel[896 + q] = d22


_ENTRY = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])  # row of the symmetric Stokeslet's entry 3 i + j


@_compiled
def _add_turned(
    x: Floats, points: Floats, base: int, weights: Floats, turn: Floats, total: Floats, slopes: Floats, with_slope: bool
) -> None:
    """Add g times the kernels of a tile, seen from `x` and weighted by `weights` (64,), to the rows of `total`.

    The entries (i, j) of the Stokeslet are in row 3 i + j, those of the derivative in row 9 + 3 i + j; the rows of
    `slopes` become the latter at each point, not rotated.
    """
    x0, x1, x2 = x[0], x[1], x[2]
    a, b, c, d, e = turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1], turn[2, 2]
    for q in range(64):
        p = base + q
        r0, r1, r2 = x0 - points[p], x1 - points[p + 64], x2 - points[p + 128]
        g00, g01, g02, g11, g12, g22, i3, square = _stokeslet(r0, r1, r2, weights[q])
        total[q] += a * g00 + b * g01
        total[64 + q] += a * g01 + b * g11
        total[128 + q] += a * g02 + b * g12
        total[192 + q] += c * g00 + d * g01
        total[256 + q] += c * g01 + d * g11
        total[320 + q] += c * g02 + d * g12
        total[384 + q] += e * g02
        total[448 + q] += e * g12
        total[512 + q] += e * g22
        if with_slope:
            f0, f1, f2 = points[p + 256], points[p + 320], points[p + 384]
            d00, d01, d02, d10, d11, d12, d20, d21, d22 = _derivative(r0, r1, r2, f0, f1, f2, i3, square)
            total[576 + q] += a * d00 + b * d10
            total[640 + q] += a * d01 + b * d11
            total[704 + q] += a * d02 + b * d12
            total[768 + q] += c * d00 + d * d10
            total[832 + q] += c * d01 + d * d11
            total[896 + q] += c * d02 + d * d12
            total[960 + q] += e * d20
            total[1024 + q] += e * d21
            total[1088 + q] += e * d22
            slopes[q] = d00
            slopes[64 + q] = d01
            slopes[128 + q] = d02
            slopes[192 + q] = d10
            slopes[256 + q] = d11
            slopes[320 + q] = d12
            slopes[384 + q] = d20
            slopes[448 + q] = d21
            slopes[512 + q] = d22


@_in_order
def _summed(rows: Floats, lanes: Floats, sums: Floats) -> None:
    """Sum each of nine rows of 64 numbers, in the same order on every processor."""
    for row in range(9):
        lanes[:] = 0.0
        for start in range(64 * row, 64 * (row + 1), 8):
            for lane in range(8):
                lanes[lane] += rows[start + lane]
        sums[row] = 0.0
        for lane in range(8):
            sums[row] += lanes[lane]


@_in_order
def _add_to_target_slope(sums: Floats, turn: Floats, slope: Floats) -> None:
    """Add g S g^T for the sums S (9,)."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    slope[i, j] += turn[i, k] * sums[3 * k + m] * turn[j, m]


@_compiled
def _rules(x: Floats, node: int, image: Integers, elements: Elements, levels: Floats, rule: Integers) -> None:
    """Choose the rule of each element seen from `x`: 0 coarse, up to m by distance, m + 1 + k singular at node k."""
    for e in range(elements.nodes.shape[0]):
        d0, d1, d2 = x[0] - elements.centres[e, 0], x[1] - elements.centres[e, 1], x[2] - elements.centres[e, 2]
        ratio = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) / elements.radii[e]
        level = 0
        while level < levels.shape[0] and ratio < levels[level]:
            level += 1
        if node >= 0 and level > 0:
            for k in range(6):
                if elements.nodes[e, k] == image[node]:
                    level = levels.shape[0] + 1 + k
        rule[e] = level


@_compiled
def _add_coarse(
    tiles: Tiles, block: int, seen_from: Floats, rule: Integers, elements: Elements, weights: Floats, total: Floats,
    slopes: Floats, sums: Floats, shape: Floats, target_slope: Floats, on_node: bool, with_slope: bool,
) -> None:  # fmt: skip
    """Add one block of rule 0 to the sums over the nodes of its elements."""
    points, base = tiles.coarse_shapes.shape[0], block * _BLOCK
    fitting = TILE // points
    first = block * fitting
    last = min(first + fitting, rule.shape[1])
    rows = 18 if with_slope else 9
    total[: rows * TILE] = 0.0
    for g in range(seen_from.shape[0]):
        for q in range(TILE):
            weights[q] = tiles.coarse[base + 192 + q]
        for e in range(first, last):
            if rule[g, e] > 0:
                weights[(e - first) * points : (e - first + 1) * points] = 0.0
        _add_turned(seen_from[g], tiles.coarse, base, weights, elements.turns[g], total, slopes, with_slope)
        if on_node and with_slope:
            _summed(slopes, weights[:8], sums)
            _add_to_target_slope(sums, elements.turns[g], target_slope)
    for e in range(first, last):
        for row in range(rows):
            start = row * TILE + (e - first) * points
            for q in range(points):
                for k in range(8):
                    shape[e, row, k] += tiles.coarse_shapes[q, k] * total[start + q]


@_compiled
def _add_fine(
    tiles: Tiles, e: int, rule: int, x: Floats, turn: Floats, kernel: Floats, local: Floats,
    sums: Floats, shape: Floats, target_slope: Floats, on_node: bool, with_slope: bool,
) -> None:  # fmt: skip
    """Add one element by one of its finer rules."""
    rows = 15 if with_slope else 6
    local[:] = 0.0
    blocks = tiles.first[-1]
    for tile in range(tiles.first[rule - 1], tiles.first[rule]):
        count = min(TILE, tiles.counts[rule - 1] - (tile - tiles.first[rule - 1]) * TILE)
        _fill(x, tiles.fine, (e * blocks + tile) * _BLOCK, count, kernel, with_slope)
        for k in range(6):
            start = (tile * 6 + k) * TILE
            for row in range(rows):
                entry = 0.0
                for q in range(count):
                    entry += tiles.fine_shapes[start + q] * kernel[row * TILE + q]
                local[k, row] += entry
    sums[:] = 0.0
    for k in range(6):
        for i in range(3):
            for j in range(3):
                for m in range(3):
                    shape[e, 3 * i + j, k] += turn[i, m] * local[k, _ENTRY[3 * m + j]]
                    if with_slope:
                        shape[e, 9 + 3 * i + j, k] += turn[i, m] * local[k, 6 + 3 * m + j]
        for row in range(9):
            sums[row] += local[k, 6 + row]  # the shape functions sum to one
    if on_node and with_slope:
        _add_to_target_slope(sums, turn, target_slope)


@_compiled
def layer_matrices(
    targets: Floats, target_nodes: Integers, elements: Elements, tiles: Tiles, unknown: int, with_slope: bool
) -> tuple[Floats, Floats, Floats]:
    """Compute the matrices of the single layer on a symmetric P2 surface, seen from `targets`.

    Parameters
    ----------
    targets : (t, 3) array
    target_nodes : (t,) int array
        The surface node each target is, or -1.
    elements : Elements
    tiles : Tiles
    unknown : int
        Number of unknown nodes.
    with_slope : bool
        True to compute derivatives.

    Returns
    -------
    velocity : (3 t, 3 unknown) array
        Velocity at the targets from the density at unknown nodes.
    source_slope : (3 t, 3 unknown) array
        Derivative of the integrand of the velocity with respect to the target, weighted by the shape functions of the
        sources: a displacement of the unknown nodes changes the velocity by minus this.
    target_slope : (t, 3, 3) array
        Derivative of the velocity with respect to the position of those targets that are nodes.
    """
    count, group, size = targets.shape[0], elements.turns.shape[0], elements.nodes.shape[0]
    velocity = np.zeros((3 * count, 3 * unknown))
    source_slope = np.zeros((3 * count, 3 * unknown if with_slope else 1))
    target_slope = np.zeros((count, 3, 3))
    seen_from, rule = np.zeros((group, 3)), np.empty((group, size), np.int64)
    kernel, total, weights = np.empty(15 * TILE), np.empty(18 * TILE), np.empty(TILE)
    local, sums, shape, slopes = np.empty((6, 15)), np.empty(9), np.empty((size, 18, 8)), np.empty(9 * TILE)
    for t in range(count):
        shape[:] = 0.0
        on_node = target_nodes[t] >= 0
        for g in range(group):
            for i in range(3):
                seen_from[g, i] = 0.0
                for j in range(3):
                    seen_from[g, i] += elements.turns[g, j, i] * targets[t, j]
            _rules(seen_from[g], target_nodes[t], elements.images[g], elements, tiles.levels, rule[g])
        for block in range(tiles.coarse.shape[0] // _BLOCK):
            _add_coarse(tiles, block, seen_from, rule, elements, weights, total, slopes, sums, shape, target_slope[t],
                        on_node, with_slope)  # fmt: skip
        for g in range(group):
            for e in range(size):
                if rule[g, e] > 0:
                    _add_fine(tiles, e, rule[g, e], seen_from[g], elements.turns[g], kernel, local, sums, shape,
                              target_slope[t], on_node, with_slope)  # fmt: skip
        for e in range(size):
            for k in range(6):
                node = elements.nodes[e, k]
                column, turn = 3 * elements.wedge_of[node], elements.operation[node]
                for i in range(3):
                    for j in range(3):
                        for m in range(3):
                            velocity[3 * t + i, column + j] += shape[e, 3 * i + m, k] * turn[m, j]
                            if with_slope:
                                source_slope[3 * t + i, column + j] += shape[e, 9 + 3 * i + m, k] * turn[m, j]
    return velocity, source_slope, target_slope
