"""What a microscope makes of an outline, as plane geometry."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.affinity import scale
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

__all__ = ["enlarged", "grown", "smeared"]

Floats = NDArray[np.float64]

_ROUND = 64  # segments of a quarter of a circle


def grown(outline: Floats, distance: float) -> Floats:
    """Outline (p, 2) of all points within a distance of the capsule; of those farther from its edge, if negative."""
    return _edge(Polygon(outline).buffer(distance, quad_segs=_ROUND))


def smeared(outline: Floats, length: float) -> Floats:
    """Outline (p, 2) of all that the capsule covers on a way along the flow, about its middle."""
    if length == 0.0:
        return outline
    way = np.array([0.5 * length, 0.0])
    following = np.roll(outline, -1, axis=0)
    swept = np.stack([outline - way, outline + way, following + way, following - way], axis=1)
    swaths = np.asarray(shapely.make_valid(shapely.polygons(swept)))
    ends = np.array([Polygon(outline - way), Polygon(outline + way)])
    return _edge(shapely.union_all(np.concatenate([swaths, ends])))


def enlarged(outline: Floats, factor: float) -> Floats:
    """Outline (p, 2) with both lengths multiplied."""
    return _edge(scale(Polygon(outline), factor, factor, origin=(0.0, 0.0)))


def _edge(area: BaseGeometry) -> Floats:
    """Vertices of the outer edge of a polygon, counterclockwise in the plane (z, y)."""
    assert isinstance(area, Polygon), "one piece"
    ring = orient(area).exterior
    return np.asarray(ring.coords, dtype=np.float64)[:-1]
