"""Channel of circular cross-section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.stokes.channel import Channel, unidirectional
from capsbayes.physics.stokes.rounded_outline import rounded_filling, rounded_outline
from capsbayes.physics.surface.symmetry import C_INF_V, D4, Symmetry


@dataclass(frozen=True)
class CircularChannel(Channel):
    """Circular tube of radius one, in which capsules are axisymmetric."""

    name: ClassVar[str] = "circular"
    symmetry: ClassVar[Symmetry] = C_INF_V
    area: ClassVar[float] = float(np.pi)
    pressure_gradient: ClassVar[float] = 8.0

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Return Poiseuille's parabola; see `Flow.undisturbed`."""
        x, y = points[:, 0], points[:, 1]
        return unidirectional(2.0 * (1.0 - x**2 - y**2), -4.0 * x, -4.0 * y)

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points on an eighth of the circle; see `Channel.outline`."""
        return rounded_outline(1.0, spacing, outwards)

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return rings on an eighth of the disk; see `Channel.filling`."""
        return rounded_filling(1.0, spacing, outwards)


@dataclass(frozen=True)
class FourfoldTube(CircularChannel):
    """Circular tube in which capsules have only the symmetry of the mesh, as when they wrinkle."""

    symmetry: ClassVar[Symmetry] = D4
