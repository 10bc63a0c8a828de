"""Stokes flow in a channel that holds a membrane: Stokeslet, single layer and the response of the walls.

Lengths are over the half width l, velocities over the mean undisturbed velocity U, stresses over mu U / l; the flow is
along z. The velocity that the membrane induces is compiled; Stokeslets outside the channel cancel it at the walls
(Pozrikidis 1992, doi 10.1017/CBO9780511624124; Fairweather & Karageorghis 1998, doi 10.1023/A:1018981221740).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numba
import numpy as np
import scipy.linalg
import scipy.sparse as sp

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.channel import Channel
from capsbayes.physics.surface import OctaSphere, Rule, dunavant, p2, singular, subdivided, tangents

# Compiled sums of Stokeslets: velocities, their matrices and their derivatives.
#
# The Stokeslet is G = I/r + r r^T / r^3 with r from source to target; the factor 1/(8 pi mu) is left to the callers

_compiled = numba.njit(cache=True, fastmath=True, error_model="numpy", nogil=True)


@_compiled
def images_matrix(targets: Floats, sources: Floats, operations: Floats) -> Floats:
    """Compute the velocity (3 t, 3 s) at `targets` (t, 3) from Stokeslets at `sources` (s, 3) and their images.

    A force at a source acts with all its images under `operations` (g, 3, 3), rotated like them.
    """
    matrix = np.zeros((3 * targets.shape[0], 3 * sources.shape[0]))
    turned, g = np.empty(3), np.empty((3, 3))
    for s in range(sources.shape[0]):
        for o in range(operations.shape[0]):
            turn = operations[o]
            for i in range(3):
                turned[i] = turn[i, 0] * sources[s, 0] + turn[i, 1] * sources[s, 1] + turn[i, 2] * sources[s, 2]
            for t in range(targets.shape[0]):
                r0, r1, r2 = targets[t, 0] - turned[0], targets[t, 1] - turned[1], targets[t, 2] - turned[2]
                i1 = 1.0 / np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
                i3 = i1 * i1 * i1
                g[0, 0], g[1, 1], g[2, 2] = i1 + r0 * r0 * i3, i1 + r1 * r1 * i3, i1 + r2 * r2 * i3
                g[0, 1] = g[1, 0] = r0 * r1 * i3
                g[0, 2] = g[2, 0] = r0 * r2 * i3
                g[1, 2] = g[2, 1] = r1 * r2 * i3
                for i in range(3):
                    for j in range(3):
                        matrix[3 * t + i, 3 * s + j] += (
                            g[i, 0] * turn[0, j] + g[i, 1] * turn[1, j] + g[i, 2] * turn[2, j]
                        )
    return matrix


@_compiled
def images_gradient(targets: Floats, sources: Floats, operations: Floats, forces: Floats) -> Floats:
    """Compute the gradient (t, 3, 3) at `targets` of the velocity of `forces` (s, 3) at `sources` and their images.

    Entry [t, i, j] is the derivative of component i along coordinate j.
    """
    gradient = np.zeros((targets.shape[0], 3, 3))
    y, f, r = np.empty(3), np.empty(3), np.empty(3)
    for s in range(sources.shape[0]):
        for o in range(operations.shape[0]):
            turn = operations[o]
            for i in range(3):
                y[i] = turn[i, 0] * sources[s, 0] + turn[i, 1] * sources[s, 1] + turn[i, 2] * sources[s, 2]
                f[i] = turn[i, 0] * forces[s, 0] + turn[i, 1] * forces[s, 1] + turn[i, 2] * forces[s, 2]
            for t in range(targets.shape[0]):
                for i in range(3):
                    r[i] = targets[t, i] - y[i]
                i1 = 1.0 / np.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
                i3 = i1 * i1 * i1
                rf = r[0] * f[0] + r[1] * f[1] + r[2] * f[2]
                for i in range(3):
                    gradient[t, i, i] += rf * i3
                    for j in range(3):
                        gradient[t, i, j] += (r[i] * f[j] - f[i] * r[j]) * i3 - 3.0 * rf * i3 * i1 * i1 * r[i] * r[j]
    return gradient


def pressure_kernel(targets: Floats, sources: Floats) -> Floats:
    """Return the pressure (t, s, 3) at `targets` per unit force at `sources`, 2 r / r^3, without 1/(8 pi)."""
    r = targets[:, None] - sources[None]
    kernel: Floats = 2.0 * r / np.linalg.norm(r, axis=-1, keepdims=True) ** 3
    return kernel


# Compiled matrices of the single layer on a symmetric P2 surface.
#
# Quadrature points lie in tiles of 64: a flat block of seven rows, the three coordinates, the weight, and the three
# components of the density. All offsets within a block are constants, which lets the compiler prove that rows do not
# overlap and work on many points at once.
#
# Only one element of each orbit is summed over. Instead of its images, the target is rotated back: with an operation g,
# G(x, g y) g f = g G(g^T x, y) f

TILE = 64
"""Quadrature points in a tile."""

POINT_ROWS = 7
"""Rows of a tile's block."""

_BLOCK = POINT_ROWS * TILE

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
    """Compute the `LayerMatrices` of a symmetric P2 surface with w unknown nodes, seen from `targets` (t, 3).

    `target_nodes` (t,) are the surface nodes that these are, or -1.
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


# Velocity of a single layer of Stokeslets on the membrane.
#
#     v(x) = 1/(8 pi) int G(x, y) f(y) dS_0(y)
#
# The density f is per area of the rest sphere and lies in the P2 space of the mesh, so the integral runs over the fixed
# rest surface while y moves with the membrane (Pozrikidis 1992, doi 10.1017/CBO9780511624124)


class LayerMatrices(NamedTuple):
    """Velocity at t targets and its derivatives, from the density at the w nodes of the wedge."""

    velocity: Floats  # (3 t, 3 w)
    # (3 t, 3 w): derivative of the integrand of the velocity along the target, weighted by the shape functions of the
    # sources: a displacement of the nodes of the wedge changes the velocity by minus this
    source_slope: Floats
    target_slope: Floats  # (t, 3, 3): derivative of the velocity along the position of those targets that are nodes


@dataclass(frozen=True)
class QuadratureChoice:
    """Quadrature rules by distance from an element, in units of the radius of the element."""

    levels: tuple[float, ...] = (3.5, 1.8)
    rules: tuple[tuple[int, int], ...] = ((5, 0), (6, 1), (5, 2))
    singular_order: int = 8


class _Tables(NamedTuple):
    """Parts of the rules that do not move with the membrane: shapes (q, 6) and weights (e, q)."""

    coarse_shapes: Floats
    coarse_weights: Floats
    fine_shapes: Floats
    fine_weights: Floats
    first: Integers  # first tile of each of the finer rules
    counts: Integers  # number of their points


def _rest_area(nodes: Floats, elements: Integers, points: Floats) -> Floats:
    """Return the area (e, q) of the rest surface per area of the unit triangle."""
    along_s, along_t = np.moveaxis(tangents(nodes, elements, points), 2, 0)
    return np.linalg.norm(np.cross(along_s, along_t), axis=-1)


@lru_cache(maxsize=8)
def _tables(mesh: OctaSphere, choice: QuadratureChoice) -> _Tables:
    elements, multiplicity = mesh.orbits
    share = multiplicity[:, None] / len(mesh.symmetry.operations)

    def weights(rule: Rule) -> Floats:
        return share * rule.weights * _rest_area(mesh.nodes, elements, rule.points)

    coarse, *regular = [subdivided(dunavant(degree), times) for degree, times in choice.rules]
    finer = regular + [singular(node, choice.singular_order) for node in range(6)]
    counts = np.array([len(rule.weights) for rule in finer])
    tiles = -(-counts // TILE)
    first = np.concatenate([[0], np.cumsum(tiles)])
    fine_shapes, fine_weights = np.zeros((first[-1] * TILE, 6)), np.zeros((len(elements), first[-1] * TILE))
    for start, rule in zip(first * TILE, finer, strict=False):
        here = slice(start, start + len(rule.weights))
        fine_shapes[here], fine_weights[:, here] = p2(rule.points), weights(rule)
    return _Tables(p2(coarse.points), weights(coarse), fine_shapes, fine_weights, first, counts)


_ELSEWHERE = 1e3  # position of points without weight, far from every target


class SingleLayer:
    """Single layer on one deformed shape, nodes (N, 3); its density (N, 3) is needed for derivatives only."""

    # The density is the force on the liquid per area of the sphere at rest, of this radius.

    def __init__(
        self,
        mesh: OctaSphere,
        radius: float,
        nodes: Floats,
        density: Floats | None = None,
        *,
        choice: QuadratureChoice = QuadratureChoice(),
    ) -> None:
        self.mesh, self.radius, self.density, self._nodes, self._choice = mesh, radius, density, nodes, choice
        elements, _ = mesh.orbits
        self._placed = nodes[elements]
        self._loads = np.zeros_like(self._placed) if density is None else density[elements]
        centres = np.mean(self._placed, axis=1)
        self._elements = Elements(
            nodes=elements,
            wedge_of=mesh.wedge_of,
            operation=mesh.operation,
            images=mesh.images,
            turns=mesh.symmetry.operations,
            centres=centres,
            radii=np.max(np.linalg.norm(self._placed - centres[:, None], axis=-1), axis=1),
        )

    @cached_property
    def _tiles(self) -> Tiles:
        tables = _tables(self.mesh, self._choice)
        scale = self.radius**2 / (8 * np.pi)
        points, count = len(tables.coarse_shapes), len(self._placed)
        fitting = TILE // points
        blocks = -(-count // fitting)
        coarse = np.zeros((blocks * fitting, points, POINT_ROWS))
        coarse[:count, :, :3] = tables.coarse_shapes @ self._placed
        coarse[:count, :, 3] = scale * tables.coarse_weights
        coarse[:count, :, 4:] = tables.coarse_shapes @ self._loads
        padded = np.zeros((blocks, TILE, POINT_ROWS))
        padded[:, : fitting * points] = coarse.reshape(blocks, -1, POINT_ROWS)
        padded[..., :3] += _ELSEWHERE * (padded[..., 3:4] == 0.0)
        shapes, weights = tables.fine_shapes, scale * tables.fine_weights
        fine = np.concatenate([shapes @ self._placed, weights[..., None], shapes @ self._loads], axis=-1)
        return Tiles(
            levels=np.array(self._choice.levels),
            coarse=padded.transpose(0, 2, 1).ravel(),
            coarse_shapes=np.pad(tables.coarse_shapes, ((0, 0), (0, 2))),
            fine=fine.reshape(-1, TILE, POINT_ROWS).transpose(0, 2, 1).ravel(),
            fine_shapes=shapes.reshape(-1, TILE, 6).transpose(0, 2, 1).ravel(),
            first=tables.first,
            counts=tables.counts,
        )

    def matrices(self, targets: Floats, *, target_nodes: Integers | None = None) -> LayerMatrices:
        """Compute the matrices from the density of the wedge to the velocity at `targets` (t, 3), with 1/(8 pi)."""
        on_nodes = np.full(len(targets), -1) if target_nodes is None else target_nodes
        of_shape = self._elements, self._tiles, len(self.mesh.wedge), self.density is not None
        return LayerMatrices(*layer_matrices(np.ascontiguousarray(targets), on_nodes, *of_shape))

    def pressure(self, targets: Floats) -> Floats:
        """Compute the pressure (t,) of the layer at points away from the membrane, over mu U/l."""
        assert self.density is not None, "the pressure is that of a density"
        rule = dunavant(6)
        elements = self.mesh.elements
        shapes = p2(rule.points)
        weights = rule.weights * _rest_area(self.mesh.nodes, elements, rule.points)
        kernel = pressure_kernel(targets, (shapes @ self._nodes[elements]).reshape(-1, 3))
        loads = (shapes @ self.density[elements]) * weights[..., None]
        return self.radius**2 / (8 * np.pi) * np.einsum("tsi,si->t", kernel, loads.reshape(-1, 3))


# The response of the walls to a disturbance, by the method of fundamental solutions.
#
# Stokeslets outside the channel cancel, in the least-squares sense, the velocity that the membrane induces on the walls
# and on two far caps (Fairweather & Karageorghis 1998, doi 10.1023/A:1018981221740). Walls stay put in the capsule's
# frame, so the system is factorised once per cross-section


@dataclass(frozen=True)
class WallDiscretisation:
    """Discretisation of the walls, in units of l."""

    spacing: float = 0.08  # of the Stokeslets near the capsule
    far_spacing: float = 0.16  # of the Stokeslets at the caps
    end: float = 3.0  # half length of the discretised channel
    near: float = 1.6  # half length with the near spacing
    offset: float = 2.0  # distance of the Stokeslets from the wall over their spacing
    oversampling: float = 1.45  # wall points over Stokeslets
    regularisation: float = 1e-5  # Tikhonov parameter over the largest diagonal of the triangular factor


def _axial(spacing: float, far_spacing: float, near: float, end: float) -> tuple[Floats, Floats]:
    """Return graded axial positions from 0 to `end` and the length of each."""
    half_near = max(int(np.ceil(near / spacing)), 1)
    edges = list(near * np.arange(half_near + 1) / half_near)
    step = near / half_near
    while edges[-1] < end:
        step = min(step * 1.1, far_spacing)
        edges.append(edges[-1] + step)
    tail = np.array(edges[half_near:])
    edges[half_near:] = list(near + (tail - near) * (end - near) / (tail[-1] - near))
    return (np.array(edges[1:]) + edges[:-1]) / 2, np.diff(edges)


class WallOperator:
    """Operator from a velocity on the walls to the strengths of the Stokeslets that cancel it."""

    # The mirror z -> -z maps walls and Stokeslets onto themselves: even and odd velocities are cancelled separately,
    # each by a system of half the size. Arrays over `points` (p, 3), one of each ring if the flow is axisymmetric, or
    # `sources` (s, 3) hold the downstream half first, then its mirror image in the same order.

    def __init__(self, channel: Channel, walls: WallDiscretisation) -> None:
        self.channel, self.walls, self.operations = channel, walls, channel.symmetry.operations
        axial, steps = _axial(
            walls.spacing, walls.far_spacing, walls.near, walls.end + walls.offset * walls.far_spacing
        )
        sources, _ = channel.wall_points(axial, steps, walls.far_spacing, offset=walls.offset, end=walls.end)
        finer = walls.oversampling**0.5
        spacing, far_spacing = walls.spacing / finer, walls.far_spacing / finer
        axial, steps = _axial(spacing, far_spacing, walls.near, walls.end)
        points, areas = channel.wall_points(axial, steps, far_spacing, offset=0.0, end=walls.end)
        self._root_areas = np.repeat(np.sqrt(areas), 3)
        self._wall, self.sources = (np.concatenate([half, half * _MIRROR]) for half in (points, sources))
        self.points, self._spread = self._wall, None
        if channel.symmetry.axisymmetric:
            asked, self._spread = _of_rings(self._wall)
            self.points = self._wall[asked]

    @cached_property
    def _inverses(self) -> tuple[Floats, Floats]:
        """Strengths per velocity on half the wall, for even and odd velocities, by regularised least squares."""
        points, sources = self._wall[: len(self._wall) // 2], self.sources[: len(self.sources) // 2]
        same = images_matrix(points, sources, self.operations)
        other = _mirrored_columns(images_matrix(points, sources * _MIRROR, self.operations))
        return self._inverse(same + other), self._inverse(same - other)

    def _inverse(self, matrix: Floats) -> Floats:
        weighted = matrix * self._root_areas[:, None]
        scale = np.sqrt(np.max(np.sum(weighted**2, axis=0)))
        damped = np.vstack([weighted, self.walls.regularisation * scale * np.eye(matrix.shape[1])])
        orthogonal, triangle = scipy.linalg.qr(damped, mode="economic", overwrite_a=True, check_finite=False)
        top = orthogonal[: matrix.shape[0]].T * self._root_areas
        inverse: Floats = scipy.linalg.solve_triangular(triangle, top, overwrite_b=True, check_finite=False)
        return inverse

    def velocity_matrix(self, targets: Floats) -> Floats:
        """Compute the velocity (3 t, 3 s) at `targets` from the Stokeslets and their images."""
        return images_matrix(np.ascontiguousarray(targets), self.sources, self.operations)

    def strengths(self, velocity: Floats) -> Floats:
        """Compute the strengths (s, 3) of the Stokeslets that cancel the velocity (3 p,) at the wall points."""
        spread = velocity if self._spread is None else self._spread @ velocity
        down, up = spread.reshape(2, -1, 3)
        even, odd = self._inverses
        even_part = -0.5 * even @ (down + up * _MIRROR).ravel()
        odd_part = -0.5 * odd @ (down - up * _MIRROR).ravel()
        here, mirrored = (even_part + odd_part).reshape(-1, 3), (even_part - odd_part).reshape(-1, 3)
        return np.concatenate([here, mirrored * _MIRROR])

    def response(self, velocity_matrix: Floats) -> Floats:
        """Compute the reduction (r, 3 p) by the walls of velocities with rows (r, 3 s), per velocity at the walls."""
        half = velocity_matrix.shape[1] // 2
        down, up = velocity_matrix[:, :half], _mirrored_columns(velocity_matrix[:, half:])
        even, odd = self._inverses
        even_part, odd_part = (down + up) @ even, (down - up) @ odd
        response: Floats = 0.5 * np.hstack([even_part + odd_part, _mirrored_columns(even_part - odd_part)])
        return response if self._spread is None else (self._spread.T @ response.T).T


def _of_rings(points: Floats) -> tuple[Integers, sp.bsr_matrix]:
    """Return one of the points (p, 3) of each ring about z, and the matrix from velocities there to all (3 p,)."""
    rings = np.round(np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]]), 9)
    _, first, ring = np.unique(rings, axis=0, return_index=True, return_inverse=True)
    ring = ring.ravel()
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    angle = azimuth - azimuth[first][ring]
    turns = np.zeros((len(points), 3, 3))
    turns[:, 0, 0], turns[:, 0, 1] = np.cos(angle), -np.sin(angle)
    turns[:, 1, 0], turns[:, 1, 1], turns[:, 2, 2] = np.sin(angle), np.cos(angle), 1.0
    shape = (3 * len(points), 3 * len(first))
    return first, sp.bsr_matrix((turns, ring, np.arange(len(points) + 1)), shape=shape)


_MIRROR = np.array([1.0, 1.0, -1.0])


def _mirrored_columns(matrix: Floats) -> Floats:
    """Change the sign of the axial component of the columns of `matrix` (r, 3 c)."""
    return matrix * np.tile(_MIRROR, matrix.shape[1] // 3)


@lru_cache(maxsize=4)  # 40 MB each
def wall_operator(channel: Channel, walls: WallDiscretisation) -> WallOperator:
    """Return the operator of a channel; kept for later calls."""
    return WallOperator(channel, walls)
