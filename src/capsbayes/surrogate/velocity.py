"""Velocity ratio between the cases: Delaunay triangles and barycentric weights in the (Ca, a/l) plane.

References
----------
Quesada, Dupont, Villon, Salsac, "Diffuse approximation for the identification
of the mechanical properties of microcapsules", section "Interpolation".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

__all__ = ["VelocityTriangulation"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VelocityTriangulation:
    """Piecewise linear v_o/U over the Delaunay triangles of the cases.

    Parameters
    ----------
    parameters : (c, 2) array [-]
        Columns (Ca, a/l) of the cases, unscaled as in the paper.
    velocity_ratio : (c,) array [U]
        v_o/U of the cases.

    Examples
    --------
    >>> corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    >>> plane = VelocityTriangulation(corners, np.array([1.0, 2.0, 4.0]))
    >>> float(plane(0.25, 0.25))
    2.0
    """

    parameters: Floats
    velocity_ratio: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "_triangles", Delaunay(self.parameters))

    def __call__(self, capillary_number: float, size_ratio: float) -> float:
        """Weighted mean of v_o/U at the vertices of the triangle that holds the point.

        A point outside every triangle takes the value of the nearest point of
        the hull: the value is then the border's, never an extrapolation.
        """
        point = np.array([capillary_number, size_ratio])
        triangles: Delaunay = self._triangles  # type: ignore[attr-defined]
        index = int(triangles.find_simplex(point))
        if index < 0:
            return self._on_the_hull(point, triangles.convex_hull)
        vertices = triangles.simplices[index]
        weights = _area_ratios(point, self.parameters[vertices])
        return float(weights @ self.velocity_ratio[vertices])

    def _on_the_hull(self, point: Floats, edges: NDArray[np.int32]) -> float:
        start, stop = self.parameters[edges[:, 0]], self.parameters[edges[:, 1]]
        along = stop - start
        share = np.clip(np.sum((point - start) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
        nearest = int(np.argmin(np.sum((start + share[:, None] * along - point) ** 2, axis=1)))
        ends = self.velocity_ratio[edges[nearest]]
        return float((1 - share[nearest]) * ends[0] + share[nearest] * ends[1])


def _area_ratios(point: Floats, vertices: Floats) -> Floats:
    """Area of each subtriangle (point and two vertices) over that of the whole, opposite vertex by vertex : (3,)."""
    towards = vertices - point
    following, last = np.roll(towards, -1, axis=0), np.roll(towards, -2, axis=0)
    areas = np.abs(following[:, 0] * last[:, 1] - following[:, 1] * last[:, 0])
    return areas / areas.sum()
