"""Simple shear without walls, u_z = y.

Lengths are over the radius a of the capsule, velocities over the shear rate
times a, so the capillary number of a problem in this flow is
Ca = mu (shear rate) a / G_s and its size ratio is 1.

The membrane rotates like the tread of a tank. The bending energy is that of
the displacement from rest, so it resists this rotation with a stress of order
B, which should stay far below Ca.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.stokes.channel import Flow, unidirectional
from capsbayes.physics.surface.symmetry import C2H, Symmetry


@dataclass(frozen=True)
class ShearFlow(Flow):
    """Simple shear along z in the plane x = 0."""

    symmetry: ClassVar[Symmetry] = C2H
    pressure_gradient: ClassVar[float] = 0.0

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Compute the flow; see `Flow.undisturbed`."""
        y = points[:, 1]
        return unidirectional(y, np.zeros_like(y), np.ones_like(y))
