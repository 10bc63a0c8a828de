"""Equations with a positive definite matrix too small for a library's call, solved in place; compiled."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def factorise(matrix):  # type: ignore[no-untyped-def]
    """Replace a positive definite matrix (k, k) by its Cholesky factor."""
    for a in range(len(matrix)):
        for b in range(a + 1):
            total = matrix[a, b]
            for c in range(b):
                total -= matrix[a, c] * matrix[b, c]
            if a == b:
                matrix[a, a] = math.sqrt(max(total, 1e-15 * matrix[a, a]))
            else:
                matrix[a, b] = total / matrix[b, b]


@njit(cache=True, nogil=True, error_model="numpy")
def substitute(factor, side):  # type: ignore[no-untyped-def]
    """Replace a right-hand side (k,) by the solution of the equations whose matrix has this Cholesky factor."""
    for a in range(len(side)):
        for b in range(a):
            side[a] -= factor[a, b] * side[b]
        side[a] /= factor[a, a]
    for a in range(len(side) - 1, -1, -1):
        for b in range(a + 1, len(side)):
            side[a] -= factor[b, a] * side[b]
        side[a] /= factor[a, a]
