"""The outline of a capsule in a picture as a measured silhouette over l, with a model of its errors.

Points three by three are one: neighbours hardly know each other's errors, and a likelihood needs no more of them. What
they share within an arc and all around is in the errors that the edge was located with; how much of these are scatter,
how much is alike along the edge, and how much is an offset of the whole was set on drawn pictures, other ones than
those that the calibration is counted on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capsbayes.image.contour import ARC, Outline
from capsbayes.image.extent import EDGE_FLOOR
from capsbayes.image.sighting import Sighting
from capsbayes.measured_outline import FEWEST_POINTS, SILHOUETTE, MeasuredOutline, OutlineNoise, Pose

__all__ = ["silhouette_of"]

Floats = NDArray[np.float64]

_WALL = 2.0  # of the width of a wall's dark line: nearer to it, blur mixes the two, and an edge is found too far out
_TOGETHER = 3  # points that are averaged
_SCATTER = 0.75, 0.15  # variance of the mean of so many over that of independent ones: at no width, and per its square
_ARC_SHARE = 0.6  # of an arc's error that is in its points
_MISFIT = 0.018  # 1/px: error along the edge over the square of its width
_OFFSET = 0.016  # 1/px: error of all edges alike over the square of their width


def silhouette_of(sighting: Sighting) -> MeasuredOutline | None:
    """The silhouette that was found, as `identify` compares it with those of a model.

    Parameters
    ----------
    sighting : Sighting

    Returns
    -------
    MeasuredOutline or None
        Without its points next to a wall, which lie up to 0.4 of the edge's width too far out. None where nothing was
        measured, hardly any point is clear of the walls, or the shape does not tell its front from its rear.
    """
    if not sighting.status.ok or sighting.outline is None or sighting.walls is None or sighting.flow == 0:
        return None
    walls = sighting.walls
    points = _averaged(sighting.outline.points)
    clear = walls.clearance(points) > _WALL * walls.line_width
    if np.count_nonzero(clear) < FEWEST_POINTS:
        return None
    points = points[clear] - sighting.axis
    placed = np.stack([sighting.flow * (points @ walls.along), points @ walls.across], axis=1) / walls.half_width
    scatter, smooth, offset = _errors(sighting.outline)
    radius = float(np.mean(np.hypot(*(placed - placed.mean(axis=0)).T)))
    noise = OutlineNoise(
        float(np.hypot(scatter, smooth)) / walls.half_width,
        ARC / walls.half_width,
        scatter**2 / (scatter**2 + smooth**2),
    )
    # a wrong l makes all radii wrong alike, much as an offset does
    pose = Pose(offset=float(np.hypot(offset, radius * walls.half_width_error)) / walls.half_width)
    return MeasuredOutline(placed, noise, pose, SILHOUETTE)


def _averaged(values: Floats) -> Floats:
    """Means of so many consecutive rows; the last few, if fewer, are left out."""
    count = len(values) // _TOGETHER
    return np.asarray(values[: count * _TOGETHER].reshape(count, _TOGETHER, -1).mean(axis=1))


def _errors(outline: Outline) -> tuple[float, float, float]:
    """Standard deviations [px] that are independent from point to point, alike along the edge, and alike all around."""
    width = np.square(outline.edge_width)
    least, more = _SCATTER
    scatter = np.mean(np.square(outline.point_error) * (least + more * width)) / _TOGETHER
    smooth = np.mean(np.square(_ARC_SHARE * outline.arc_error) + np.square(_MISFIT * width))
    offset = EDGE_FLOOR**2 + np.mean(np.square(_OFFSET * width))
    return float(np.sqrt(scatter)), float(np.sqrt(smooth)), float(np.sqrt(offset))
