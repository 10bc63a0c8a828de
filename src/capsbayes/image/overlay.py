"""Overlay of a detection on its picture: walls, outline, the two lengths and the rear band."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.files.output_file import write_file
from capsbayes.image.detection import Detection
from capsbayes.image.files.picture import Picture

Colour = tuple[int, int, int]

_SCALE = 4  # drawn pixels per pixel of the picture
_SHIFT = 4  # binary digits of a drawn pixel's fractions
WALL, OUTLINE, REAR, EXTENT, LENGTH = (200, 120, 0), (0, 0, 220), (0, 150, 255), (180, 0, 140), (0, 140, 0)


def overlay(picture: Picture, detection: Detection) -> NDArray[np.uint8]:
    """Draw a detection over its picture, four times as large : (4 rows, 4 columns, 3) array, in OpenCV's order.

    Walls are blue, the outline red, the rear band orange, L_z violet above the axis, L_a green below. The dark blob of
    a refused capsule is outlined in orange. What is missing in the detection is not drawn.
    """
    low, high = float(picture.grey.min()), float(picture.grey.max())
    grey = np.clip(255.0 * (picture.grey - low) / max(high - low, 1e-9), 0, 255).astype(np.uint8)
    size = (grey.shape[1] * _SCALE, grey.shape[0] * _SCALE)
    large = cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC)
    canvas = np.repeat(np.asarray(large, dtype=np.uint8)[:, :, None], 3, axis=2)
    if detection.walls is not None:
        walls = detection.walls
        middle = np.array([walls.centre_column, walls.centre_row])
        for side in (-1.0, 1.0):
            ends = [-1.2 * walls.centre_column, 1.2 * walls.centre_column]
            _line(canvas, [middle + side * walls.half_width * walls.across + end * walls.along for end in ends], WALL)
    if detection.outline is not None:
        _line(canvas, list(detection.outline.points), OUTLINE, closed=True)
    elif detection.blob is not None:
        _line(canvas, list(detection.blob.polygon), REAR, closed=True)
    if detection.nose is not None and detection.end is not None:
        _lengths(canvas, detection)
    return canvas


def write_overlay(path: Path, picture: Picture, detection: Detection) -> None:
    """Draw an overlay and write it as a PNG file."""
    _, png = cv2.imencode(".png", overlay(picture, detection))
    write_file(path, png.tobytes())


def _lengths(canvas: NDArray[np.uint8], detection: Detection) -> None:
    walls, nose, end = detection.walls, detection.nose, detection.end
    assert walls is not None
    assert nose is not None
    assert end is not None
    downstream = (detection.flow or 1) * walls.along
    axis = detection.axis
    tip = axis + nose.distance * downstream
    _arrow(canvas, axis - end.distance * downstream - 6.0 * walls.across, tip - 6.0 * walls.across, EXTENT)
    if detection.rear is not None:
        rear = detection.rear
        on_axis = axis + (rear.depth - end.distance) * downstream
        y = np.linspace(-rear.breadth, rear.breadth, 21)[:, None]
        _line(canvas, list(on_axis + y * walls.across + 0.5 * rear.curvature * y**2 * downstream), REAR)
        _arrow(canvas, on_axis + 6.0 * walls.across, tip + 6.0 * walls.across, LENGTH)


def _drawn(points: list[Floats]) -> NDArray[np.int32]:
    """Return positions on the canvas, in OpenCV's fixed-point numbers for fractions of a pixel."""
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
