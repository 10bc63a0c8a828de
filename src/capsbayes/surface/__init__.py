"""The rest sphere: symmetric mesh, shape functions, quadrature."""

from capsbayes.surface.octasphere import OctaSphere, octasphere
from capsbayes.surface.symmetry import C2H, C_INF_V, D2, D4, Symmetry

__all__ = ["C2H", "C_INF_V", "D2", "D4", "OctaSphere", "Symmetry", "octasphere"]
