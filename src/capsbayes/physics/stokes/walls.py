"""The response of the walls to a disturbance, by the method of fundamental solutions.

Stokeslets outside the channel cancel, in the least-squares sense, the velocity
that the membrane induces on the walls and on two far caps (Fairweather &
Karageorghis 1998, doi 10.1023/A:1018981221740). Walls stay put in the
capsule's frame, so the system is factorised once per cross-section.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from capsbayes.arrays import Floats, Integers
from capsbayes.physics.stokes.channel import Channel
from capsbayes.physics.stokes.stokeslet import images_matrix


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


@cache
def wall_operator(channel: Channel, walls: WallDiscretisation) -> WallOperator:
    """Return the operator of a channel; the same object for the same arguments."""
    return WallOperator(channel, walls)
