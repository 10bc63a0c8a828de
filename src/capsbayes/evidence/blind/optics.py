"""Changes of an outline by a microscope, as plane geometry; outlines are (p, 2) arrays."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.affinity import scale
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from capsbayes.arrays import Floats
from capsbayes.profile import arc_length, vertex_normals

_ROUND = 64  # segments of a quarter of a circle
_WAVES = 6  # of the arc


def grown(outline: Floats, distance: float) -> Floats:
    """Return the outline of all points within a distance of the capsule; it shrinks if the distance is negative."""
    return _edge(Polygon(outline).buffer(distance, quad_segs=_ROUND))


def smeared(outline: Floats, length: float) -> Floats:
    """Return the outline of the area that the capsule covers while it moves by a length along the flow."""
    if length == 0.0:
        return outline
    half = np.array([0.5 * length, 0.0])
    following = np.roll(outline, -1, axis=0)
    swept = np.stack([outline - half, outline + half, following + half, following - half], axis=1)
    swaths = np.asarray(shapely.make_valid(shapely.polygons(swept)))
    ends = np.array([Polygon(outline - half), Polygon(outline + half)])
    return _edge(shapely.union_all(np.concatenate([swaths, ends])))


def enlarged(outline: Floats, along: float, across: float) -> Floats:
    """Return the outline scaled about the origin, along the flow and across it."""
    return _edge(scale(Polygon(outline), along, across, origin=(0.0, 0.0)))


def distorted(outline: Floats, size: float) -> Floats:
    """Return the outline in the middle of a picture that a lens distorts, over the half width as seen there."""
    # A point at a distance r from the middle is seen at r (1 + size r^2).
    middle = np.mean(Polygon(outline).bounds[::2])

    def seen(points: Floats) -> Floats:
        radial = points - [middle, 0.0]
        return np.asarray(radial * (1.0 + size * np.sum(radial**2, axis=1, keepdims=True)) / (1.0 + size))

    return _edge(shapely.transform(Polygon(outline), seen))


def in_perspective(outline: Floats, size: float) -> Floats:
    """Return the outline in the middle of a picture of a tilted plane."""
    # Along a half width downstream the plane comes nearer to the lens by the share `size` of its distance.
    middle = np.mean(Polygon(outline).bounds[::2])

    def seen(points: Floats) -> Floats:
        away = points - [middle, 0.0]
        return np.asarray(away / (1.0 - size * away[:, :1]))

    return _edge(shapely.transform(Polygon(outline), seen))


def smooth_pattern(outline: Floats, seed: int) -> Floats:
    """Return displacements (p, 2) along the normals: a smooth random function of the arc of unit root mean square."""
    cosines, sines = np.random.default_rng([seed, _WAVES]).standard_normal((2, _WAVES))
    arc = arc_length(outline)
    phase = 2.0 * np.pi * np.outer(arc[:-1] / arc[-1], np.arange(1, _WAVES + 1))
    pattern = (np.cos(phase) @ cosines + np.sin(phase) @ sines) / np.sqrt(0.5 * np.sum(cosines**2 + sines**2))
    return np.asarray(pattern[:, None] * vertex_normals(outline))


def _edge(area: BaseGeometry) -> Floats:
    """Return the vertices of the outer edge of a polygon, counterclockwise in the plane (z, y)."""
    assert isinstance(area, Polygon), "one piece"
    ring = orient(area).exterior
    return np.asarray(ring.coords, dtype=np.float64)[:-1]
