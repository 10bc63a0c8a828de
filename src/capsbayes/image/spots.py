"""Dark spots between the walls: which of them are capsules that can be measured, and why the others are not."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.image.wall import Walls
from capsbayes.status import Status

__all__ = ["Spot", "find_spots", "judged"]

Floats = NDArray[np.float64]

_SMALLEST_AREA = 0.2  # l^2: smaller spots are debris
_SPECK = 0.02  # l^2: smaller ones are nothing
_CONTRAST = 0.03  # of the light: fainter is nothing
_SIGNIFICANCE = 5.0  # of the contrast over the noise of a smoothed pixel
_BORDER = 3  # px: nearer to the border of the picture the outline cannot be located
_NOTCH = 1.5, 0.1  # px, and of the radius of a circle of the same area: concave rears leave up to 0.07
_CLEARANCE = 12.0  # px that an edge needs on its outside to be located
_DARKEST = 0.01, 0.1  # of the pixels between the walls, of l^2: half as dark as these is the level of a spot


@dataclass(frozen=True, eq=False)
class Spot:
    """A dark spot.

    Parameters
    ----------
    polygon : (p, 2) array [px]
        Its outline to a pixel, columns (x, y), clockwise as seen in the picture.
    area : float [px^2]
    status : Status
        ``DONE`` if it can be a capsule to measure.
    """

    polygon: Floats = field(repr=False)
    area: float
    status: Status = Status.DONE

    @property
    def middle(self) -> Floats:
        """Middle (x, y) of its box : (2,) array [px]."""
        return np.asarray(0.5 * (self.polygon.min(axis=0) + self.polygon.max(axis=0)))


def find_spots(light: Floats, walls: Walls, noise: float) -> list[Spot]:
    """Find the dark spots between the walls.

    Parameters
    ----------
    light : (rows, columns) array
        Share of the light of the empty channel.
    walls : Walls
        Walls of the channel.
    noise : float
        Standard deviation of one pixel of `light`.

    Returns
    -------
    list of Spot
        From left to right.
    """
    dark = cv2.GaussianBlur(np.subtract(1.0, light, dtype=np.float32), (0, 0), 1.0)
    between = _between(walls, (light.shape[0], light.shape[1]))
    inside = dark[between]
    share, squares = _DARKEST
    darkest = min(share * inside.size, squares * walls.half_width**2)
    level = 0.5 * float(np.partition(inside, -round(darkest) - 1)[-round(darkest) - 1])
    if level < max(_CONTRAST, _SIGNIFICANCE * 0.3 * noise):
        return []
    mask = ((dark > level) & between).astype(np.uint8)
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), dtype=np.uint8))
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    spots = [
        Spot(_clockwise(contour[:, 0].astype(float)), area)
        for contour in contours
        if (area := cv2.contourArea(contour)) > _SPECK * walls.half_width**2
    ]
    spots.sort(key=lambda spot: float(spot.middle[0]))
    last = np.array(dark.shape[::-1]) - 1.0
    return [replace(spot, status=_status(spot, spots, last, walls.half_width)) for spot in spots]


@lru_cache(maxsize=1)  # the frames of a film share it
def _between(walls: Walls, shape: tuple[int, int]) -> NDArray[np.bool_]:
    mask: NDArray[np.bool_] = np.abs(walls.offset(shape)) < walls.half_width - 0.5 * walls.line_width
    mask.flags.writeable = False
    return mask


def judged(contour: NDArray[Any], shape: tuple[int, ...], half_width: float) -> Spot:
    """The spot that a contour of OpenCV encloses in a picture of a shape, with its status if it were the only one."""
    spot = Spot(_clockwise(contour[:, 0].astype(float)), cv2.contourArea(contour))
    return replace(spot, status=_status(spot, [], np.array(shape[::-1]) - 1.0, half_width))


def _status(spot: Spot, spots: list[Spot], last: Floats, half_width: float) -> Status:
    if spot.polygon.min() < _BORDER or np.any(spot.polygon > last - _BORDER):
        return Status.TOUCHES_BORDER
    if spot.area < _SMALLEST_AREA * half_width**2:
        return Status.DEBRIS
    if notch(spot.polygon) > max(_NOTCH[0], _NOTCH[1] * np.sqrt(spot.area / np.pi)):
        return Status.DOUBLET
    low, high = spot.polygon.min(axis=0) - _CLEARANCE, spot.polygon.max(axis=0) + _CLEARANCE
    for other in spots:
        if other is not spot and np.any(np.all((other.polygon > low) & (other.polygon < high), axis=1)):
            return Status.TOO_CLOSE
    return Status.DONE


def notch(polygon: Floats) -> float:
    """Depth of the deepest hollow of an outline below its convex hull [px]."""
    corners = np.rint(polygon).astype(np.int32)[:, None]
    hull = cv2.convexHull(corners, returnPoints=False)
    hull[::-1].sort(axis=0)  # where a contour passes a pixel twice, OpenCV wants the hull in one sense
    defects = cv2.convexityDefects(corners, hull)
    return 0.0 if defects is None else float(defects.reshape(-1, 4)[:, 3].max()) / 256.0


def _clockwise(polygon: Floats) -> Floats:
    x, y = polygon.T
    return polygon if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0.0 else polygon[::-1]
