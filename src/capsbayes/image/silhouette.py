"""The outline of a capsule in a picture as a measured silhouette over l, with a model of its errors.

Three consecutive points are averaged: their errors are almost independent, and a likelihood needs no more points. The
noise has three parts: scatter from point to point, errors alike along the edge, and an offset of the whole. They follow
from the errors with which the edge was located; their factors were set on drawn pictures, other ones than those whose
coverage is counted. Where the edge of the rear is a band, much wider than that of the nose, the membrane lies somewhere
within: that of the rear has an error of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.image.detection import Detection
from capsbayes.image.edges.extent import EDGE_FLOOR
from capsbayes.image.edges.outline import ARC, scatter_expected, thinned, without_erased
from capsbayes.image.walls import WallLines
from capsbayes.measured_outline import FEWEST_POINTS, SILHOUETTE, MeasuredOutline, OutlineNoise, Pose

_ARC_SHARE = 0.6  # of an arc's error that is in its points
_MISFIT = 0.024  # 1/px: error along the edge over the square of its width
_OF_SHIFT = 0.5  # of the error of a smoothed picture's edges, which differ as their dark lines do
_FACING = 0.8  # cosine of a normal's angle to the channel, least at the ends
_BAND = 1.5  # of the square of the width at the nose: in drawn pictures that at the rear is 0.8 to 1.35 of it
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
    rear : float
        Of the rear, along the flow, and the same in all pictures of a capsule.
    """

    scatter: float
    arc: float
    misfit: float
    offset: float
    rear: float = 0.0

    @classmethod
    def of(cls, detection: Detection) -> EdgeErrors:
        """Return the errors that follow from those with which the outline of a detection was located."""
        outline, walls = detection.outline, detection.walls
        assert outline is not None
        assert walls is not None
        kept = ~outline.erased
        width = np.square(outline.edge_width[kept])
        arc = _ARC_SHARE * np.sqrt(np.mean(np.square(outline.arc_error[kept])))
        misfit = np.hypot(_MISFIT * np.sqrt(np.mean(np.square(width))), _OF_SHIFT * detection.shift)
        offset = np.sqrt(EDGE_FLOOR**2 + detection.shift**2 + _OFFSET**2 * np.mean(np.square(width)))
        facing = detection.flow * (outline.normals[kept] @ walls.along)
        nose, rear = (float(np.mean(width[side * facing > _FACING])) if detection.flow else 0.0 for side in (1, -1))
        band = float(np.sqrt(rear - nose)) if rear > _BAND * nose else 0.0
        return cls(scatter_expected(outline), float(arc), float(misfit), float(offset), band)


def silhouette_of(detection: Detection) -> MeasuredOutline | None:
    """Return the silhouette of a detection, as `identify` compares it with those of a model.

    Points next to a wall, which lie up to 0.4 of the edge's width too far out, and erased ones are omitted. Returns
    None where nothing was measured, too few points are left, or the shape does not distinguish front from rear.
    """
    if not detection.status.ok or detection.outline is None or detection.walls is None or detection.flow == 0:
        return None
    walls = detection.walls
    points = thinned(detection.outline.points)
    clear = walls.is_clear(walls.clearance(points)) & without_erased(detection.outline)
    points = points[clear] - detection.axis
    return over_l(
        np.stack([detection.flow * (points @ walls.along), points @ walls.across], axis=1),
        EdgeErrors.of(detection),
        walls,
    )


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
    offset = np.hypot(errors.offset, radius * walls.half_width_error)
    pose = Pose(offset=float(offset) / half_width, rear=errors.rear / half_width)
    return MeasuredOutline(points, noise, pose, SILHOUETTE)
