"""Compiled sums of Stokeslets: velocities, their matrices and their derivatives.

The Stokeslet is G = I/r + r r^T / r^3 with r from source to target; the factor
1/(8 pi mu) is left to the callers.
"""

from __future__ import annotations

import numba
import numpy as np

from capsbayes.arrays import Floats

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
