"""Undisturbed flows and straight channels: what all cross-sections share.

Lengths are over the half width l, velocities over the mean velocity U. The
flow is along z; the picture shows y, in which the half width is one; x is the
direction of view.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.surface.symmetry import Symmetry


class Flow(ABC):
    """An undisturbed flow and its symmetry."""

    symmetry: ClassVar[Symmetry]

    @property
    @abstractmethod
    def pressure_gradient(self) -> float:
        """-(dp/dz) l^2 / (mu U) of the undisturbed flow."""

    @abstractmethod
    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the velocity (p, 3) at `points` (p, 3) and its gradient (p, 3, 3), [p, i, j] that of v_i along j."""


class Channel(Flow):
    """A straight channel along z; a subclass places the points of its cross-section in the wedge of its symmetry."""

    # The wedge is 0 <= y <= x under D4 and 0 <= x, y under D2.

    name: ClassVar[str]

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of the cross-section over l^2."""

    @abstractmethod
    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points (p, 2) `spacing` apart on the wall moved `outwards`, and the length (p,) of each."""

    @abstractmethod
    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points (p, 2) `spacing` apart that fill the widened cross-section, and the area (p,) of each."""

    def wall_points(
        self, axial: Floats, steps: Floats, cap_spacing: float, *, offset: float, end: float
    ) -> tuple[Floats, Floats]:
        """Return points (p, 3) on the downstream wall and its end cap, moved outwards, and the areas they stand for."""
        # One point of each orbit. `axial`, `steps` (m,): positions of the rings of points and the length each stands
        # for, also the distance of its points along the outline; `offset`: distance from wall and cap over the spacing;
        # `end`: of the cap.
        points, areas = [], []
        for z, step in zip(axial, steps, strict=True):
            ring, lengths = self.outline(step, offset * step)
            points.append(_at(ring, z))
            areas.append(step * lengths)
        cap, cap_areas = self.filling(cap_spacing, offset * cap_spacing)
        points.append(_at(cap, end + offset * cap_spacing))
        areas.append(cap_areas)
        return np.concatenate(points), np.concatenate(areas)


def _at(points: Floats, z: float) -> Floats:
    return np.column_stack([points, np.full(len(points), z)])


def midpoints(length: float, spacing: float) -> tuple[Floats, float]:
    """Return the midpoints of equal steps of at most `spacing` that fill `length`, and the step.

    >>> midpoints(1.0, 0.3)
    (array([0.125, 0.375, 0.625, 0.875]), 0.25)
    """
    count = int(np.ceil(length / spacing))
    return (np.arange(count) + 0.5) * length / count, length / count


def unidirectional(axial: Floats, along_x: Floats, along_y: Floats) -> tuple[Floats, Floats]:
    """Return velocity (p, 3) and gradient (p, 3, 3) of a flow along z from its axial component and its slopes (p,)."""
    velocity, gradient = np.zeros((len(axial), 3)), np.zeros((len(axial), 3, 3))
    velocity[:, 2], gradient[:, 2, 0], gradient[:, 2, 1] = axial, along_x, along_y
    return velocity, gradient
