"""Points on and within a square with rounded corners, of which the circle is the limit."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.stokes.channel import midpoints


def _along(radius: float, spacing: float, outwards: float) -> tuple[Floats, Floats, float]:
    """Return the points (p, 2) of the eighth, their normals (p, 2) and the length of each."""
    straight, turn = 1.0 - radius, radius + outwards
    along, step = midpoints(straight + np.pi / 4 * turn, spacing)
    angle = np.maximum(along - straight, 0.0) / turn
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    middles = np.column_stack([np.full_like(along, straight), np.minimum(along, straight)])
    return middles + turn * normals, normals, step


def rounded_outline(radius: float, spacing: float, outwards: float) -> tuple[Floats, Floats]:
    """Return the eighth 0 <= y <= x of the outline; see `Channel.outline`. A circle has corners of radius 1."""
    points, _, step = _along(radius, spacing, outwards)
    return points, np.full(len(points), step)


def rounded_filling(radius: float, spacing: float, outwards: float) -> tuple[Floats, Floats]:
    """Return rings, each a smaller outline, that fill the eighth; see `Channel.filling`."""
    scales, scale_step = midpoints(1.0, spacing / (1.0 + outwards))
    rings, areas = [], []
    for scale in scales:
        points, normals, step = _along(radius, spacing / scale, outwards)
        rings.append(scale * points)
        areas.append(scale * scale_step * np.sum(points * normals, axis=1) * step)
    return np.concatenate(rings), np.concatenate(areas)
