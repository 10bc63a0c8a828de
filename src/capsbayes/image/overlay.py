"""What was found, drawn over the picture: walls, outline, the two lengths and the rear band."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.image.frames import Picture
from capsbayes.image.sighting import Sighting

__all__ = ["overlay", "write_overlay"]

Floats = NDArray[np.float64]
Colour = tuple[int, int, int]

_SCALE = 4  # pixels drawn for one of the picture's
_SHIFT = 4  # binary digits of a drawn pixel's fractions
WALL, OUTLINE, REAR, EXTENT, LENGTH = (200, 120, 0), (0, 0, 220), (0, 150, 255), (180, 0, 140), (0, 140, 0)


def overlay(picture: Picture, sighting: Sighting) -> NDArray[np.uint8]:
    """Draw what was found over a picture, four times as large.

    Parameters
    ----------
    picture : Picture
    sighting : Sighting
        What was found in it; what was not is not drawn.

    Returns
    -------
    (4 rows, 4 columns, 3) array of uint8
        Blue, green, red, as OpenCV writes it. Walls blue, outline red, the rear band orange, L_z violet above the
        axis, L_a green below. Of a refused capsule, the dark spot is outlined in orange.
    """
    low, high = float(picture.grey.min()), float(picture.grey.max())
    grey = np.clip(255.0 * (picture.grey - low) / max(high - low, 1e-9), 0, 255).astype(np.uint8)
    size = (grey.shape[1] * _SCALE, grey.shape[0] * _SCALE)
    large = cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC)
    canvas = np.repeat(np.asarray(large, dtype=np.uint8)[:, :, None], 3, axis=2)
    if sighting.walls is not None:
        walls = sighting.walls
        middle = np.array([walls.middle, walls.height])
        for side in (-1.0, 1.0):
            ends = [-1.2 * walls.middle, 1.2 * walls.middle]
            _line(canvas, [middle + side * walls.half_width * walls.across + end * walls.along for end in ends], WALL)
    if sighting.outline is not None:
        _line(canvas, list(sighting.outline.points), OUTLINE, closed=True)
    elif sighting.spot is not None:
        _line(canvas, list(sighting.spot.polygon), REAR, closed=True)
    if sighting.nose is not None and sighting.end is not None:
        _lengths(canvas, sighting)
    return canvas


def write_overlay(path: Path, picture: Picture, sighting: Sighting) -> None:
    """Write `overlay` as a PNG file."""
    _, png = cv2.imencode(".png", overlay(picture, sighting))
    path.write_bytes(png.tobytes())


def _lengths(canvas: NDArray[np.uint8], sighting: Sighting) -> None:
    walls, nose, end = sighting.walls, sighting.nose, sighting.end
    assert walls is not None
    assert nose is not None
    assert end is not None
    downstream = (sighting.flow or 1) * walls.along
    axis = sighting.axis
    tip = axis + nose.distance * downstream
    _arrow(canvas, axis - end.distance * downstream - 6.0 * walls.across, tip - 6.0 * walls.across, EXTENT)
    if sighting.rear is not None:
        rear = sighting.rear
        on_axis = axis + (rear.depth - end.distance) * downstream
        y = np.linspace(-rear.breadth, rear.breadth, 21)[:, None]
        _line(canvas, list(on_axis + y * walls.across + 0.5 * rear.curvature * y**2 * downstream), REAR)
        _arrow(canvas, on_axis + 6.0 * walls.across, tip + 6.0 * walls.across, LENGTH)


def _drawn(points: list[Floats]) -> NDArray[np.int32]:
    """Positions on the canvas, in the fixed-point numbers that OpenCV draws fractions of a pixel with."""
    on_canvas = _SCALE * (np.array(points) + 0.5) - 0.5
    return np.rint(on_canvas * 2**_SHIFT).astype(np.int32)


def _line(canvas: NDArray[np.uint8], points: list[Floats], colour: Colour, *, closed: bool = False) -> None:
    cv2.polylines(canvas, [_drawn(points)], closed, colour, 1, cv2.LINE_AA, _SHIFT)


def _arrow(canvas: NDArray[np.uint8], start: Floats, stop: Floats, colour: Colour) -> None:
    along = (stop - start) / np.hypot(*(stop - start))
    across = np.array([-along[1], along[0]])
    _line(canvas, [start, stop], colour)
    for end, sense in ((start, 1.0), (stop, -1.0)):
        _line(canvas, [end + sense * 3.0 * along + across, end, end + sense * 3.0 * along - across], colour)
