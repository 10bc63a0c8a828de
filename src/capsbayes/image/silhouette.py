"""The outline of a capsule in a picture as a measured silhouette over l, with a model of its errors.

Three consecutive points are averaged: their errors are almost independent, and a likelihood needs no more points. The
noise has three parts: scatter from point to point, errors alike along the edge, and an offset of the whole. They follow
from the errors with which the edge was located; their factors were set on drawn pictures, other ones than those whose
coverage is counted.
"""

from __future__ import annotations

import numpy as np

from capsbayes.image.detection import Detection
from capsbayes.image.edges.extent import EDGE_FLOOR
from capsbayes.image.edges.outline import ARC, EdgeOutline, averaged, scatter_expected
from capsbayes.measured_outline import FEWEST_POINTS, SILHOUETTE, MeasuredOutline, OutlineNoise, Pose

_WALL = 2.0  # of the width of a wall's dark line: nearer to it, blur mixes the two, and an edge is found too far out
_ARC_SHARE = 0.6  # of an arc's error that is in its points
_MISFIT = 0.024  # 1/px: error along the edge over the square of its width
_OFFSET = 0.02  # 1/px: common error of all edges over the square of their width


def silhouette_of(detection: Detection) -> MeasuredOutline | None:
    """Return the silhouette of a detection, as `identify` compares it with those of a model.

    Points next to a wall, which lie up to 0.4 of the edge's width too far out, are omitted. Returns None where nothing
    was measured, too few points are clear of the walls, or the shape does not distinguish front from rear.
    """
    if not detection.status.ok or detection.outline is None or detection.walls is None or detection.flow == 0:
        return None
    walls = detection.walls
    points = averaged(detection.outline.points)
    clear = walls.clearance(points) > _WALL * walls.line_width
    if np.count_nonzero(clear) < FEWEST_POINTS:
        return None
    points = points[clear] - detection.axis
    over_l = np.stack([detection.flow * (points @ walls.along), points @ walls.across], axis=1) / walls.half_width
    scatter, smooth, offset = _errors(detection.outline)
    radius = float(np.mean(np.hypot(*(over_l - over_l.mean(axis=0)).T)))
    noise = OutlineNoise(
        float(np.hypot(scatter, smooth)) / walls.half_width,
        ARC / walls.half_width,
        scatter**2 / (scatter**2 + smooth**2),
    )
    # an error of l changes all radii in proportion, much as an offset does
    pose = Pose(offset=float(np.hypot(offset, radius * walls.half_width_error)) / walls.half_width)
    return MeasuredOutline(over_l, noise, pose, SILHOUETTE)


def _errors(outline: EdgeOutline) -> tuple[float, float, float]:
    """Return the standard deviations [px] that are independent, alike along the edge, and alike all around."""
    width = np.square(outline.edge_width)
    smooth = np.mean(np.square(_ARC_SHARE * outline.arc_error) + np.square(_MISFIT * width))
    offset = EDGE_FLOOR**2 + np.mean(np.square(_OFFSET * width))
    return scatter_expected(outline), float(np.sqrt(smooth)), float(np.sqrt(offset))
