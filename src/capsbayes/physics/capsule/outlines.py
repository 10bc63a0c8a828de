"""Outlines of a deformed shape: its profile in the plane x = 0 and its silhouette seen along x."""

from __future__ import annotations

import numpy as np
from numba import njit

from capsbayes.arrays import Floats
from capsbayes.physics.surface.facets import subdivision
from capsbayes.physics.surface.octasphere import OctaSphere
from capsbayes.physics.surface.shape_functions import p2
from capsbayes.profile import Profile

_POINTS_PER_EDGE = 16
_PARTS_PER_EDGE = 6
_DIRECTIONS = 721


def profile(mesh: OctaSphere, nodes: Floats) -> Profile:
    """Return the outline in the plane x = 0, on the curved edges of the elements, in the unit of the nodes (N, 3)."""
    meridian = np.flatnonzero((np.abs(mesh.nodes[:, 0]) < 1e-12) & (mesh.nodes[:, 1] > -1e-12))
    meridian = meridian[np.argsort(-mesh.nodes[meridian, 2])]  # corner, midside, corner, ... from nose to rear
    along = np.arange(_POINTS_PER_EDGE) / _POINTS_PER_EDGE
    shapes = np.stack([(1 - along) * (1 - 2 * along), 4 * along * (1 - along), along * (2 * along - 1)])
    curve = nodes[meridian][:, [2, 1]]
    edges = np.stack([curve[0:-2:2], curve[1:-1:2], curve[2::2]])
    points = np.einsum("kq,kei->eqi", shapes, edges).reshape(-1, 2)
    return Profile.from_half(np.concatenate([points, curve[-1:]]))


def silhouette(mesh: OctaSphere, nodes: Floats) -> Profile:
    """Return the outline of the shape seen along x: the farthest point in every direction, in the unit of the nodes."""
    # The rear rim lies further back along the diagonals of the cross-section than in the plane x = 0, so the silhouette
    # is longer than the profile and hides a concave rear.
    starts, ends = _edges(mesh, nodes)
    middle = 0.5 * (np.max(starts[:, 0]) + np.min(starts[:, 0]))
    angles = np.linspace(0.0, np.pi, _DIRECTIONS)
    radii = _farthest(starts - [middle, 0.0], ends - [middle, 0.0], angles)
    half = np.column_stack([middle + radii * np.cos(angles), radii * np.sin(angles)])
    half[[0, -1], 1] = 0.0
    return Profile.from_half(half)


def _edges(mesh: OctaSphere, nodes: Floats) -> tuple[Floats, Floats]:
    """Return the edges ((m, 2), (m, 2)), columns (z, y), of the finely divided elements on y >= 0."""
    grid, triangles = subdivision(_PARTS_PER_EDGE)
    oriented = triangles[: _PARTS_PER_EDGE * (_PARTS_PER_EDGE + 1) // 2]
    first, second = oriented[:, [0, 0, 1]].ravel(), oriented[:, [1, 2, 2]].ravel()
    points = (p2(grid) @ nodes[mesh.quarter])[..., [2, 1]]
    return points[:, first].reshape(-1, 2), points[:, second].reshape(-1, 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _farthest(starts, ends, angles):  # type: ignore[no-untyped-def]
    """Return the largest distance from the origin at which the ray of each rising angle meets one of the edges."""
    cosines, sines, radii = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    step = angles[1] - angles[0]
    for edge in range(len(starts)):
        (z, y), (z_end, y_end) = starts[edge], ends[edge]
        angle, angle_end = np.arctan2(y, z), np.arctan2(y_end, z_end)
        first = int(max(np.floor((min(angle, angle_end) - angles[0]) / step), 0.0))
        last = int(min(np.ceil((max(angle, angle_end) - angles[0]) / step), len(angles) - 1.0))
        for ray in range(first, last + 1):
            offset = cosines[ray] * y - sines[ray] * z
            offset_end = cosines[ray] * y_end - sines[ray] * z_end
            if offset * offset_end <= 0.0:
                across = offset - offset_end
                share = min(max(offset / across, 0.0), 1.0) if across != 0.0 else 0.0
                ahead = cosines[ray] * (z + share * (z_end - z)) + sines[ray] * (y + share * (y_end - y))
                radii[ray] = max(radii[ray], ahead)
    return radii
