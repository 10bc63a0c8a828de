"""The rest sphere: symmetric mesh, shape functions, quadrature."""

from capsbayes.physics.surface.octasphere import OctaSphere, octasphere
from capsbayes.physics.surface.symmetry import C2H, C_INF_V, D2, D4, Symmetry

__all__ = ["C2H", "C_INF_V", "D2", "D4", "OctaSphere", "Symmetry", "octasphere"]
