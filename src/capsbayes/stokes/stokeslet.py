"""Compiled sums of Stokeslets: velocities, their matrices and their derivatives.

The Stokeslet is G = I/r + r r^T / r^3 with r from source to target; the factor
1/(8 pi mu) belongs to the callers.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["images_gradient", "images_matrix", "layer_matrices", "pressure_kernel"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_compiled = numba.njit(cache=True, fastmath=True, error_model="numpy", nogil=True)


@_compiled
def _add(
    target: Array,
    y: Array,
    force: Array,
    weight: float,
    shapes: Array,
    local: Array,
    slope: Array,
    total: Array,
    with_slope: bool,
) -> None:
    """Add one quadrature point to an element's 3x3 blocks `local` (velocity) and `slope` (its derivative)."""
    r0, r1, r2 = target[0] - y[0], target[1] - y[1], target[2] - y[2]
    i1 = 1.0 / np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
    i3 = i1 * i1 * i1
    g00, g11, g22 = i1 + r0 * r0 * i3, i1 + r1 * r1 * i3, i1 + r2 * r2 * i3
    g01, g02, g12 = r0 * r1 * i3, r0 * r2 * i3, r1 * r2 * i3
    for k in range(6):
        c = weight * shapes[k]
        local[k, 0] += c * g00
        local[k, 1] += c * g01
        local[k, 2] += c * g02
        local[k, 3] += c * g11
        local[k, 4] += c * g12
        local[k, 5] += c * g22
    if with_slope:
        f0, f1, f2 = force[0] * weight, force[1] * weight, force[2] * weight
        rf = r0 * f0 + r1 * f1 + r2 * f2
        a, b = rf * i3, 3.0 * rf * i3 * i1 * i1
        d00, d01, d02 = a - b * r0 * r0, (r0 * f1 - f0 * r1) * i3 - b * r0 * r1, (r0 * f2 - f0 * r2) * i3 - b * r0 * r2
        d10, d11, d12 = (r1 * f0 - f1 * r0) * i3 - b * r1 * r0, a - b * r1 * r1, (r1 * f2 - f1 * r2) * i3 - b * r1 * r2
        d20, d21, d22 = (r2 * f0 - f2 * r0) * i3 - b * r2 * r0, (r2 * f1 - f2 * r1) * i3 - b * r2 * r1, a - b * r2 * r2
        for k in range(6):
            s = shapes[k]
            slope[k, 0] += s * d00
            slope[k, 1] += s * d01
            slope[k, 2] += s * d02
            slope[k, 3] += s * d10
            slope[k, 4] += s * d11
            slope[k, 5] += s * d12
            slope[k, 6] += s * d20
            slope[k, 7] += s * d21
            slope[k, 8] += s * d22
        total[0] += d00
        total[1] += d01
        total[2] += d02
        total[3] += d10
        total[4] += d11
        total[5] += d12
        total[6] += d20
        total[7] += d21
        total[8] += d22


@_compiled
def layer_matrices(
    targets: Array,
    target_nodes: Indices,
    elements: Indices,
    wedge_of: Indices,
    operation: Array,
    centres: Array,
    radii: Array,
    levels: Array,
    offsets: Indices,
    y: Array,
    f: Array,
    w: Array,
    shapes: Array,
    corner_y: Array,
    corner_f: Array,
    corner_w: Array,
    corner_shapes: Array,
    wedge_count: int,
    with_slope: bool,
) -> tuple[Array, Array, Array]:
    """Matrices of the single layer on a symmetric P2 surface, seen from `targets`.

    Parameters
    ----------
    targets : (t, 3) array
    target_nodes : (t,) int array
        The surface node each target is, or -1.
    elements : (e, 6) int array
    wedge_of, operation : (N,) int array, (N, 3, 3) array
        Each node's wedge node and the operation from it.
    centres, radii : (e, 3) array, (e,) array
        A ball around each element, which chooses the rule.
    levels : (m,) array
        Decreasing ratios of distance to radius: rule i serves ratios above levels[i]; the last serves the rest.
    offsets : (m + 2,) int array
        Where each regular rule's points lie in the arrays below.
    y, f : (e, q, 3) arrays
        Quadrature points and densities there (all regular rules one after another).
    w, shapes : (e, q) array, (q, 6) array
    corner_y, corner_f, corner_w, corner_shapes : (e, 6, s, 3), (e, 6, s, 3), (e, 6, s) and (6, s, 6) arrays
        The same for the rules singular at each local node.
    wedge_count : int
    with_slope : bool
        Whether derivatives are wanted.

    Returns
    -------
    velocity : (3 t, 3 wedge_count) array
        Velocity at the targets from the density at wedge nodes.
    source_slope : (3 t, 3 wedge_count) array
        Derivative of the velocity's integrand with respect to the target, carried by the sources' shape functions:
        moving the wedge nodes changes the velocity by minus this.
    target_slope : (t, 3, 3) array
        Derivative of the velocity with respect to the target's position.
    """
    count = targets.shape[0]
    width = 3 * wedge_count
    velocity = np.zeros((3 * count, width))
    source_slope = np.zeros((3 * count, width if with_slope else 1))
    target_slope = np.zeros((count, 3, 3))
    local, slope, total = np.empty((6, 6)), np.empty((6, 9)), np.empty(9)
    block, tilted = np.empty((3, 3)), np.empty((3, 3))
    for t in range(count):
        target = targets[t]
        total[:] = 0.0
        for e in range(elements.shape[0]):
            local[:] = 0.0
            slope[:] = 0.0
            corner = -1
            if target_nodes[t] >= 0:
                for k in range(6):
                    if elements[e, k] == target_nodes[t]:
                        corner = k
            if corner >= 0:
                for q in range(corner_w.shape[2]):
                    _add(target, corner_y[e, corner, q], corner_f[e, corner, q], corner_w[e, corner, q],
                         corner_shapes[corner, q], local, slope, total, with_slope)  # fmt: skip
            else:
                d0, d1, d2 = target[0] - centres[e, 0], target[1] - centres[e, 1], target[2] - centres[e, 2]
                ratio = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) / radii[e]
                level = 0
                while level < levels.shape[0] and ratio < levels[level]:
                    level += 1
                for q in range(offsets[level], offsets[level + 1]):
                    _add(target, y[e, q], f[e, q], w[e, q], shapes[q], local, slope, total, with_slope)
            for k in range(6):
                node = elements[e, k]
                column, turn = 3 * wedge_of[node], operation[node]
                block[0, 0], block[0, 1], block[0, 2] = local[k, 0], local[k, 1], local[k, 2]
                block[1, 0], block[1, 1], block[1, 2] = local[k, 1], local[k, 3], local[k, 4]
                block[2, 0], block[2, 1], block[2, 2] = local[k, 2], local[k, 4], local[k, 5]
                for i in range(3):
                    for j in range(3):
                        velocity[3 * t + i, column + j] += (
                            block[i, 0] * turn[0, j] + block[i, 1] * turn[1, j] + block[i, 2] * turn[2, j]
                        )
                if with_slope:
                    for i in range(3):
                        for j in range(3):
                            tilted[i, j] = slope[k, 3 * i + j]
                    for i in range(3):
                        for j in range(3):
                            source_slope[3 * t + i, column + j] += (
                                tilted[i, 0] * turn[0, j] + tilted[i, 1] * turn[1, j] + tilted[i, 2] * turn[2, j]
                            )
        for i in range(3):
            for j in range(3):
                target_slope[t, i, j] = total[3 * i + j]
    return velocity, source_slope, target_slope


@_compiled
def images_matrix(targets: Array, sources: Array, operations: Array) -> Array:
    """Velocity (3 t, 3 s) at `targets` (t, 3) from Stokeslets at `sources` (s, 3) and their images.

    A force at a source acts with all its images under `operations` (g, 3, 3), turned as they are.
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
def images_gradient(targets: Array, sources: Array, operations: Array, forces: Array) -> Array:
    """Gradient (t, 3, 3) at `targets` of the velocity of `forces` (s, 3) at `sources` and of their images.

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


def pressure_kernel(targets: Array, sources: Array) -> Array:
    """Pressure (t, s, 3) at `targets` per unit force at `sources`: 2 r / r^3, the factor 1/(8 pi) apart."""
    r = targets[:, None] - sources[None]
    kernel: Array = 2.0 * r / np.linalg.norm(r, axis=-1, keepdims=True) ** 3
    return kernel
