"""Quadratic (P2) shape functions on the unit triangle.

Local nodes: three corners (0,0), (1,0), (0,1), then the midsides of the edges
0-1, 1-2 and 2-0.
"""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats

LOCAL_NODES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
"""Positions of the six local nodes on the unit triangle (6, 2)."""

CORNERS = LOCAL_NODES[:3]


def p2(points: Floats) -> Floats:
    """Compute the shape functions at positions (..., 2) on the unit triangle : (..., 6) array [-]."""
    s, t = points[..., 0], points[..., 1]
    r = 1.0 - s - t
    return np.stack([r * (2 * r - 1), s * (2 * s - 1), t * (2 * t - 1), 4 * r * s, 4 * s * t, 4 * t * r], axis=-1)


def p2_gradient(points: Floats) -> Floats:
    """Compute the derivatives of the shape functions along both local coordinates : (..., 6, 2) array [-]."""
    s, t = points[..., 0], points[..., 1]
    r = 1.0 - s - t
    zero = np.zeros_like(s)
    along_s = np.stack([1 - 4 * r, 4 * s - 1, zero, 4 * (r - s), 4 * t, -4 * t], axis=-1)
    along_t = np.stack([1 - 4 * r, zero, 4 * t - 1, -4 * s, 4 * s, 4 * (r - t)], axis=-1)
    return np.stack([along_s, along_t], axis=-1)
