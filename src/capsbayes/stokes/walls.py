"""The walls' answer to a disturbance, by the method of fundamental solutions.

Stokeslets outside the channel cancel, in the least-squares sense, the velocity
that the membrane induces on the walls and on two far caps (Fairweather &
Karageorghis 1998, doi 10.1023/A:1018981221740). Walls stay put in the
capsule's frame, so the system is factorised once per section.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from capsbayes.stokes.channel import Channel
from capsbayes.stokes.stokeslet import images_matrix

__all__ = ["WallOperator", "Walls", "wall_operator"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Walls:
    """How finely the walls are represented, in units of l.

    Attributes
    ----------
    spacing : float
        Distance between Stokeslets near the capsule.
    far_spacing : float
        The same at the caps.
    end : float
        Half length of the channel that is represented.
    near : float
        Half length that keeps the near spacing.
    offset : float
        Distance of the Stokeslets from the wall over their spacing.
    oversampling : float
        Wall points over Stokeslets.
    regularisation : float
        Tikhonov parameter over the largest diagonal of the triangular factor.
    """

    spacing: float = 0.1
    far_spacing: float = 0.16
    end: float = 3.0
    near: float = 1.6
    offset: float = 2.0
    oversampling: float = 1.45
    regularisation: float = 1e-5


def _axial(spacing: float, far_spacing: float, near: float, end: float) -> tuple[Array, Array]:
    """Symmetric graded axial positions and the length each stands for."""
    half_near = max(int(np.ceil(near / spacing)), 1)
    edges = list(near * np.arange(half_near + 1) / half_near)
    step = near / half_near
    while edges[-1] < end:
        step = min(step * 1.1, far_spacing)
        edges.append(edges[-1] + step)
    tail = np.array(edges[half_near:])
    edges[half_near:] = list(near + (tail - near) * (end - near) / (tail[-1] - near))
    full = np.concatenate([-np.array(edges[:0:-1]), np.array(edges)])
    return (full[1:] + full[:-1]) / 2, np.diff(full)


class WallOperator:
    """Strengths of the Stokeslets that cancel a velocity on the walls.

    Parameters
    ----------
    channel : Channel
    walls : Walls
    operations : (g, 3, 3) array
        Operations of the symmetry group.
    """

    def __init__(self, channel: Channel, walls: Walls, operations: Array) -> None:
        self.channel, self.walls, self.operations = channel, walls, operations
        offset = walls.offset * walls.spacing
        axial, steps = _axial(walls.spacing, walls.far_spacing, walls.near, walls.end + offset)
        self.sources = channel.wall_points(axial, steps, walls.spacing, offset=offset, end=walls.end).points
        finer = walls.oversampling**0.5
        axial, steps = _axial(walls.spacing / finer, walls.far_spacing / finer, walls.near, walls.end)
        self.points, areas = channel.wall_points(axial, steps, walls.spacing / finer, offset=0.0, end=walls.end)
        self._root_areas = np.repeat(np.sqrt(areas), 3)

    @cached_property
    def inverse(self) -> Array:
        """(3 sources, 3 points): strengths per velocity on the wall points, Tikhonov-regularised least squares."""
        matrix = images_matrix(self.points, self.sources, self.operations) * self._root_areas[:, None]
        unknowns = matrix.shape[1]
        scale = np.sqrt(np.max(np.sum(matrix**2, axis=0)))
        damped = np.vstack([matrix, self.walls.regularisation * scale * np.eye(unknowns)])
        orthogonal, triangle = scipy.linalg.qr(damped, mode="economic", overwrite_a=True, check_finite=False)
        top = orthogonal[: matrix.shape[0]].T * self._root_areas
        return scipy.linalg.solve_triangular(triangle, top, overwrite_b=True, check_finite=False)

    def velocity_matrix(self, targets: Array) -> Array:
        """(3 t, 3 sources): velocity at `targets` from the Stokeslets and their images."""
        return images_matrix(np.ascontiguousarray(targets), self.sources, self.operations)


_OPERATORS: dict[tuple[Channel, Walls], WallOperator] = {}


def wall_operator(channel: Channel, walls: Walls, operations: Array) -> WallOperator:
    """The operator of a section; the same one is returned for the same arguments."""
    key = (channel, walls)
    if key not in _OPERATORS:
        _OPERATORS[key] = WallOperator(channel, walls, operations)
    return _OPERATORS[key]
