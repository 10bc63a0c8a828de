"""The outline of a capsule in a picture as a measured silhouette over l, with a model of its errors.

Three consecutive points are averaged: their errors are almost independent, and a likelihood needs no more points. The
noise has three parts: scatter from point to point, errors alike along the edge, and an offset of the whole. They follow
from the errors with which the edge was located; their factors were set on drawn pictures, other ones than those whose
coverage is counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.detection import Detection
from capsbayes.image.edges.extent import EDGE_FLOOR
from capsbayes.image.edges.outline import ARC, EdgeOutline, averaged, scatter_expected
from capsbayes.image.walls import WallLines
from capsbayes.measured_outline import FEWEST_POINTS, SILHOUETTE, MeasuredOutline, OutlineNoise, Pose

_WALL = 2.0  # of the width of a wall's dark line: nearer to it, blur mixes the two, and an edge is found too far out
_ARC_SHARE = 0.6  # of an arc's error that is in its points
_MISFIT = 0.024  # 1/px: error along the edge over the square of its width
_OFFSET = 0.02  # 1/px: common error of all edges over the square of their width


@dataclass(frozen=True)
class EdgeErrors:
    """Standard deviations of the errors of a silhouette's points along their normals [px].

    Parameters
    ----------
    scatter : float
        Of means of three points, independent of each other and in each picture.
    arc : float
        Alike along an arc, and independent in each picture.
    misfit : float
        Alike along an arc, and the same in all pictures of a capsule: that of the edge's model.
    offset : float
        Alike all around, and the same in all pictures of a capsule.
    """

    scatter: float
    arc: float
    misfit: float
    offset: float

    @classmethod
    def of(cls, outline: EdgeOutline) -> EdgeErrors:
        """Return the errors that follow from those with which an outline was located."""
        width = np.square(outline.edge_width)
        arc = _ARC_SHARE * np.sqrt(np.mean(np.square(outline.arc_error)))
        misfit = _MISFIT * np.sqrt(np.mean(np.square(width)))
        offset = np.hypot(EDGE_FLOOR, _OFFSET * np.sqrt(np.mean(np.square(width))))
        return cls(scatter_expected(outline), float(arc), float(misfit), float(offset))


def silhouette_of(detection: Detection) -> MeasuredOutline | None:
    """Return the silhouette of a detection, as `identify` compares it with those of a model.

    Points next to a wall, which lie up to 0.4 of the edge's width too far out, are omitted. Returns None where nothing
    was measured, too few points are clear of the walls, or the shape does not distinguish front from rear.
    """
    if not detection.status.ok or detection.outline is None or detection.walls is None or detection.flow == 0:
        return None
    walls = detection.walls
    points = averaged(detection.outline.points)
    clear = is_clear(walls.clearance(points), walls)
    points = points[clear] - detection.axis
    return over_l(
        np.stack([detection.flow * (points @ walls.along), points @ walls.across], axis=1),
        EdgeErrors.of(detection.outline),
        walls,
    )


def is_clear(clearance: Floats, walls: WallLines) -> Booleans:
    """Return which points are far enough from the walls, by their distances from the nearer one [px]."""
    return np.asarray(clearance > _WALL * walls.line_width)


def over_l(points: Floats, errors: EdgeErrors, walls: WallLines) -> MeasuredOutline | None:
    """Return the silhouette with points (m, 2) along and across the flow [px]; None if they are too few."""
    if len(points) < FEWEST_POINTS:
        return None
    half_width, smooth = walls.half_width, np.hypot(errors.arc, errors.misfit)
    points = points / half_width
    radius = float(np.mean(np.hypot(*(points - points.mean(axis=0)).T)))
    noise = OutlineNoise(
        float(np.hypot(errors.scatter, smooth)) / half_width,
        ARC / half_width,
        float(errors.scatter**2 / (errors.scatter**2 + smooth**2)),
    )
    # an error of l changes all radii in proportion, much as an offset does
    pose = Pose(offset=float(np.hypot(errors.offset, radius * walls.half_width_error)) / half_width)
    return MeasuredOutline(points, noise, pose, SILHOUETTE)
