"""The rest sphere: symmetric mesh, shape functions, quadrature."""

from capsbayes.surface.octasphere import D4, OctaSphere, octasphere

__all__ = ["D4", "OctaSphere", "octasphere"]
