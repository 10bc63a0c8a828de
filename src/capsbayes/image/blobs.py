"""Dark blobs between the walls: those that are capsules to measure, and the reasons why the others are not."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.edges.bridging import bridged, within
from capsbayes.image.walls import WallLines
from capsbayes.profile import signed_area
from capsbayes.status import Status

_SMALLEST_AREA = 0.2  # l^2: smaller blobs are debris
_SPECK = 0.02  # l^2: smaller blobs are ignored
_CONTRAST = 0.03  # of the light: fainter blobs are ignored
_SIGNIFICANCE = 5.0  # of the contrast over the noise of a smoothed pixel
_BORDER = 3  # px: nearer to the border of the picture the outline cannot be located
_NOTCH = 1.5, 0.1  # px, and of the radius of a circle of the same area: concave rears leave up to 0.07
_CLEARANCE = 12.0  # px that an edge needs on its outside to be located
_DARKEST = 0.01, 0.1  # of the pixels between the walls, of l^2: half as dark as these is the level of a blob
_BY_WALL = 0.5  # of the half width from the axis: a capsule that leaves the picture is nearer to it
_PIECE = 0.02  # of the largest piece of a mask: smaller pieces are ignored


@dataclass(frozen=True, eq=False)
class Blob:
    """A dark blob.

    Parameters
    ----------
    polygon : (p, 2) array [px]
        Outline to a pixel, columns (x, y), clockwise as seen in the picture.
    area : float [px^2]
    status : Status
        ``DONE`` if it can be a capsule to measure.
    erased : (p,) array of bool, optional
        Where the outline was erased, and is a bridge.
    """

    polygon: Floats = field(repr=False)
    area: float
    status: Status = Status.DONE
    erased: Booleans | None = field(default=None, repr=False)

    @property
    def middle(self) -> Floats:
        """Middle (x, y) of the bounding box : (2,) array [px]."""
        return np.asarray(0.5 * (self.polygon.min(axis=0) + self.polygon.max(axis=0)))


def find_blobs(light: Floats, walls: WallLines, noise: float, erased: Floats | None = None) -> list[Blob]:
    """Find the dark blobs between the walls, from left to right.

    The light (rows, columns) is over that of the empty channel, the noise the standard deviation of one pixel of it.
    Outlines are erased within boxes (k, 4) of left, upper, right and lower limit [px]; what lies there is no blob.
    """
    dark = cv2.GaussianBlur(np.subtract(1.0, light, dtype=np.float32), (0, 0), 1.0)
    between = _between(walls, (light.shape[0], light.shape[1]))
    least = max(_CONTRAST, _SIGNIFICANCE * 0.3 * noise)
    # half as dark as the darkest pixels is the level: where fewer are twice as dark as the least one, there is no blob
    darkest = dark[between & (dark >= 2.0 * least)]
    share, squares = _DARKEST
    rank = round(min(share * np.count_nonzero(between), squares * walls.half_width**2)) + 1
    if len(darkest) < rank:
        return []
    level = 0.5 * float(np.partition(darkest, -rank)[-rank])
    mask = ((dark > level) & between).astype(np.uint8)
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), dtype=np.uint8))
    blobs = [blob for blob in _pieces(np.asarray(closed, dtype=np.uint8)) if blob.area > _SPECK * walls.half_width**2]
    if erased is not None:
        blobs = [left for blob in blobs if (left := _erased(blob, erased)) is not None]
    blobs.sort(key=lambda blob: float(blob.middle[0]))
    return [replace(blob, status=_status(blob, blobs, dark.shape, walls.half_width)) for blob in blobs]


def _erased(blob: Blob, boxes: Floats) -> Blob | None:
    """Return a blob without what lies within boxes, None if that is all of it."""
    found = bridged(blob.polygon, within(blob.polygon, boxes))
    return None if found is None else replace(blob, polygon=found[0], erased=found[1])


def is_shadow(blob: Blob, walls: WallLines, columns: int) -> bool:
    """Return True for a blob that runs through a picture of so many columns, or leaves it along one wall only."""
    x = blob.polygon[:, 0]
    left, right = x < _BORDER, x > columns - 1.0 - _BORDER
    if left.any() and right.any():
        return True
    leaving = (blob.polygon[left | right] - walls.middle) @ walls.across / walls.half_width
    return len(leaving) > 0 and bool(np.abs(leaving).min() > _BY_WALL and abs(np.sign(leaving).mean()) == 1.0)


def blob_of_mask(mask: Booleans, walls: WallLines) -> Blob:
    """Return the object that a mask (rows, columns) shows; an object in several pieces is refused."""
    pieces = sorted(_pieces(mask.astype(np.uint8)), key=lambda blob: blob.area)
    if not pieces:
        return Blob(np.zeros((1, 2)), 0.0, Status.NO_CAPSULE)
    *others, blob = pieces
    if others and others[-1].area > _PIECE * blob.area:
        return replace(blob, status=Status.BROKEN_MASK)
    return replace(blob, status=_status(blob, [], mask.shape, walls.half_width))


def _pieces(mask: NDArray[np.uint8]) -> list[Blob]:
    """Return the connected pieces of a mask, their status not yet judged."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [Blob(_clockwise(contour[:, 0].astype(float)), cv2.contourArea(contour)) for contour in contours]


@lru_cache(maxsize=1)  # the frames of a film share it
def _between(walls: WallLines, shape: tuple[int, int]) -> Booleans:
    mask: Booleans = np.abs(walls.offset(shape)) < walls.half_width - 0.5 * walls.line_width
    mask.flags.writeable = False
    return mask


def _status(blob: Blob, blobs: list[Blob], shape: tuple[int, ...], half_width: float) -> Status:
    """Judge a blob in a picture of a shape with other blobs."""
    rows, columns = shape
    if blob.polygon.min() < _BORDER or np.any(blob.polygon > np.array([columns, rows]) - 1.0 - _BORDER):
        return Status.TOUCHES_BORDER
    if blob.area < _SMALLEST_AREA * half_width**2:
        return Status.DEBRIS
    if notch(blob.polygon) > max(_NOTCH[0], _NOTCH[1] * np.sqrt(blob.area / np.pi)):
        return Status.DOUBLET
    low, high = blob.polygon.min(axis=0) - _CLEARANCE, blob.polygon.max(axis=0) + _CLEARANCE
    for other in blobs:
        if other is not blob and np.any(np.all((other.polygon > low) & (other.polygon < high), axis=1)):
            return Status.TOO_CLOSE
    return Status.DONE


def notch(polygon: Floats) -> float:
    """Return the depth of the deepest hollow of an outline below its convex hull [px]."""
    corners = np.rint(polygon).astype(np.int32)[:, None]
    hull = cv2.convexHull(corners, returnPoints=False)
    hull[::-1].sort(axis=0)  # where a contour passes a pixel twice, OpenCV needs the hull in one sense
    defects = cv2.convexityDefects(corners, hull)
    return 0.0 if defects is None else float(defects.reshape(-1, 4)[:, 3].max()) / 256.0


def _clockwise(polygon: Floats) -> Floats:
    return polygon if signed_area(polygon) > 0.0 else polygon[::-1]
