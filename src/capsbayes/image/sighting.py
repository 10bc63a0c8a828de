"""What was found of one capsule in a picture, in pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capsbayes.image.contour import Outline, sharpened
from capsbayes.image.extent import Extreme, furthest
from capsbayes.image.integrals import Silhouette, centroid, silhouette
from capsbayes.image.rear import RearBand, find_rear
from capsbayes.image.spots import Spot
from capsbayes.image.wall import Walls
from capsbayes.status import Status

__all__ = ["Sighting", "sighted"]

Floats = NDArray[np.float64]

_ASYMMETRY = 0.005  # of the length: a centroid nearer to the middle does not tell front from rear
_LOPSIDED = 0.08  # of the breadth: real beads and cells stay below 0.04
_ENDS = 0.17  # of the length, which are left out at either end
# 1/px: how far the edge found may lie from the true one, over its width squared; at the end more, as a concave rear
# darkens what lies behind it. Both were set on drawn pictures, other ones than those that the coverage is counted on.
_NOSE_MISFIT, _END_MISFIT = 0.012, 0.033


@dataclass(frozen=True, eq=False)
class Sighting:
    """What was found in a picture, in pixels.

    Parameters
    ----------
    status : Status
        ``DONE``, or why there is nothing to measure; then what could not be found is None.
    walls : Walls, optional
    outline : Outline, optional
    flow : int
        1 to the right, -1 to the left, 0 if the shape does not tell.
    nose, end : Extreme, optional
        Furthest points downstream and upstream, as distances along the flow from the picture's origin.
    rear : RearBand, optional
        The concave rear where it is seen.
    spot : Spot, optional
        What it was looked for in.
    """

    status: Status
    walls: Walls | None = None
    outline: Outline | None = None
    flow: int = 0
    nose: Extreme | None = None
    end: Extreme | None = None
    rear: RearBand | None = None
    spot: Spot | None = None

    @property
    def axis(self) -> Floats:
        """Point (x, y) of the capsule's axis nearest to the picture's origin : (2,) array [px]; NaN where missing."""
        if self.walls is None or self.outline is None:
            return np.full(2, np.nan)
        across = self.outline.points @ self.walls.across
        return np.asarray(0.5 * (across.max() + across.min()) * self.walls.across)

    @property
    def lengths(self) -> Floats:
        """L_z, L_a, L_p and l : (4,) array [px]; NaN where missing."""
        if self.walls is None or self.nose is None or self.end is None:
            return np.full(4, np.nan)
        extent = self.nose.distance + self.end.distance
        depth = np.nan if self.rear is None else self.rear.depth
        return np.array([extent, extent - depth, depth, self.walls.half_width])

    @property
    def covariance(self) -> Floats:
        """Covariance of the errors of `lengths` : (4, 4) array [px^2]."""
        return self._covariance(lasting=False)

    @property
    def lasting_covariance(self) -> Floats:
        """The part of `covariance` that is the same in all pictures of a capsule : (4, 4) array [px^2]."""
        return self._covariance(lasting=True)

    @property
    def silhouette(self) -> Silhouette | None:
        """What the outline encloses, with errors."""
        if self.walls is None or self.outline is None:
            return None
        return silhouette(self.outline, self.axis, self.walls.across, _NOSE_MISFIT)

    def _covariance(self, *, lasting: bool) -> Floats:
        if self.walls is None or self.nose is None or self.end is None:
            return np.full((4, 4), np.nan)
        # the rays that find the rear start at the end of the silhouette as found: its error is none of the rear's
        rear = self.rear
        behind = np.nan if rear is None else rear.lasting if lasting else rear.depth_error**2
        nose, end = ((one.lasting if lasting else one.variance) for one in (self.nose, self.end))
        wall = self.walls.half_width_error**2
        return np.array(
            [
                [nose + end, nose, end, 0.0],
                [nose, nose + behind, -behind, 0.0],
                [end, -behind, end + behind, 0.0],
                [0.0, 0.0, 0.0, wall],
            ]
        )


def sighted(light: Floats, noise: float, walls: Walls, spot: Spot, flow: int = 0) -> Sighting:
    """Locate the edge of a spot, its ends and its rear.

    Parameters
    ----------
    light : (rows, columns) array
        Share of the light of the empty channel.
    noise : float
        Standard deviation of one pixel of `light`.
    walls : Walls
    spot : Spot
    flow : int
        1 to the right, -1 to the left, 0 to be told by the shape.

    Returns
    -------
    Sighting
    """
    if not spot.status.ok:
        return Sighting(spot.status, walls, spot=spot)
    outline = sharpened(light, spot.polygon, noise)
    if outline is None:
        return Sighting(Status.NO_EDGE, walls, spot=spot)
    if _askew(outline, walls) > _LOPSIDED:
        return Sighting(Status.LOPSIDED, walls, outline, spot=spot)
    found = _found_flow(outline, walls)
    if flow and found == -flow:
        return Sighting(Status.WRONG_FLOW, walls, outline, found, spot=spot)
    return _measured(light, noise, Sighting(Status.DONE, walls, outline, flow or found, spot=spot))


def _askew(outline: Outline, walls: Walls) -> float:
    """How far the middle between the two flanks wanders, over the breadth."""
    along, across = outline.points @ walls.along, outline.points @ walls.across
    places = along.min() + np.ptp(along) * np.linspace(_ENDS, 1.0 - _ENDS, 9)
    below = across > 0.5 * (across.max() + across.min())
    flanks = []
    for side in (below, ~below):
        order = np.argsort(along[side])
        flanks.append(np.interp(places, along[side][order], across[side][order]))
    return float(0.5 * np.ptp(flanks[0] + flanks[1]) / np.ptp(across))


def _found_flow(outline: Outline, walls: Walls) -> int:
    """Direction of the flow from the shape: the rear is blunt, so the centroid lies on its side of the middle."""
    along = outline.points @ walls.along
    lead = (0.5 * (along.max() + along.min()) - centroid(outline.points) @ walls.along) / np.ptp(along)
    return 0 if abs(lead) < _ASYMMETRY else int(np.sign(lead))


def _measured(light: Floats, noise: float, sighting: Sighting) -> Sighting:
    """Add the ends and the rear; a shape that tells no direction has no concave rear to look for."""
    walls, outline = sighting.walls, sighting.outline
    assert walls is not None
    assert outline is not None
    downstream = (sighting.flow or 1) * walls.along
    nose = furthest(outline, downstream, _NOSE_MISFIT)
    end = furthest(outline, -downstream, _END_MISFIT)
    sighting = replace(sighting, nose=nose, end=end)
    if sighting.flow == 0:
        return sighting
    half_height = 0.5 * float(np.ptp(outline.points @ walls.across))
    start = sighting.axis - end.distance * downstream
    flank = np.abs(outline.normals @ walls.across) > 0.8
    blur = float(np.median(outline.edge_width[flank])) if flank.any() else float(np.median(outline.edge_width))
    rear = find_rear(light, start, downstream, nose.distance + end.distance, half_height, blur, noise)
    return replace(sighting, rear=rear)
