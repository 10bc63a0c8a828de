"""Overlay of a detection on its picture: walls, outline, the two lengths and the rear band."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.files.output_file import write_file
from capsbayes.image.detect import Detection
from capsbayes.image.edge_models import runs
from capsbayes.image.edges import EdgeOutline
from capsbayes.image.files import Picture
from capsbayes.image.walls import WallLines

Colour = tuple[int, int, int]

_LARGEST_SCALE = 4  # drawn pixels per pixel of the picture
_MOST_DRAWN = 2**23  # pixels to which a picture is enlarged
_SHIFT = 4  # binary digits of a drawn pixel's fractions
_EVERY = 3  # pieces of an erased stretch: one is drawn
_DASHES, _DOTS = (6.0, 4.0), (0.5, 5.0)  # px: drawn and left out
WALL, OUTLINE, REAR, EXTENT, LENGTH = (200, 120, 0), (0, 0, 220), (0, 150, 255), (180, 0, 140), (0, 140, 0)


def overlay(picture: Picture, detection: Detection) -> NDArray[np.uint8]:
    """Draw a detection over its picture, s times as large : (s rows, s columns, 3) array, in OpenCV's order."""
    # Stated walls are dashed and their axis dotted; a dark line that such a wall lies off is dashed orange. Erased
    # stretches of the outline are dotted, the dark blob of a refused capsule is outlined in orange.
    grey = _stretched(picture)
    scale = int(np.clip(math.isqrt(_MOST_DRAWN // grey.size), 1, _LARGEST_SCALE))
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    canvas = _Canvas(np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR), dtype=np.uint8), scale)
    if detection.walls is not None:
        _walls(canvas, detection.walls, picture.shape[1])
    if detection.outline is not None:
        _outline(canvas, detection.outline)
    elif detection.blob is not None:
        canvas.line(list(detection.blob.polygon), REAR, closed=True)
    if detection.nose is not None and detection.end is not None:
        _lengths(canvas, detection, detection.nose.distance, detection.end.distance)
    return canvas.pixels


def png_of(picture: Picture, *, widest: int) -> bytes:
    """Return a picture alone as a PNG file, made smaller where a side is longer than `widest` pixels."""
    grey = _stretched(picture)
    scale = min(1.0, widest / max(grey.shape))
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".png", small)[1].tobytes()


def _stretched(picture: Picture) -> NDArray[np.uint8]:
    """Return grey levels from the darkest pixel to the brightest as 0 to 255."""
    low, high = float(picture.grey.min()), float(picture.grey.max())
    return np.asarray(cv2.convertScaleAbs(picture.grey - low, alpha=255.0 / max(high - low, 1e-9)), dtype=np.uint8)


def write_overlay(path: Path, picture: Picture, detection: Detection) -> None:
    """Draw an overlay and write it as a PNG file."""
    _, png = cv2.imencode(".png", overlay(picture, detection))
    write_file(path, png.tobytes())


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A picture `scale` times as large, on which lines are drawn between points of the picture."""

    pixels: NDArray[np.uint8]
    scale: int

    def line(self, points: list[Floats], colour: Colour, *, closed: bool = False) -> None:
        drawn = self.scale * (np.array(points) + 0.5) - 0.5
        fixed = np.rint(drawn * 2**_SHIFT).astype(np.int32)  # OpenCV's numbers for fractions of a pixel
        cv2.polylines(self.pixels, [fixed], closed, colour, 1, cv2.LINE_AA, _SHIFT)

    def arrow(self, start: Floats, stop: Floats, colour: Colour) -> None:
        along = (stop - start) / np.hypot(*(stop - start))
        across = np.array([-along[1], along[0]])
        self.line([start, stop], colour)
        for end, sense in ((start, 1.0), (stop, -1.0)):
            self.line([end + sense * 3.0 * along + across, end, end + sense * 3.0 * along - across], colour)


def _walls(canvas: _Canvas, walls: WallLines, columns: int) -> None:
    walls = walls.centred_at(0.5 * (columns - 1))
    reach = 0.6 * columns
    dash, gap = _DASHES if walls.stated else (2.0 * reach, 0.0)
    wall = walls.half_width
    lines = [(-wall, dash, gap, WALL), (wall, dash, gap, WALL), *([(0.0, *_DOTS, WALL)] if walls.stated else [])]
    for side, off in zip((-1.0, 1.0), walls.off_band, strict=True):
        if off:
            lines.append((side * (wall - off), *_DASHES, REAR))
    for place, drawn, skipped, colour in lines:
        start = walls.middle + place * walls.across
        for first in np.arange(-reach, reach, drawn + skipped):
            canvas.line([start + end * walls.along for end in (first, first + drawn)], colour)


def _outline(canvas: _Canvas, outline: EdgeOutline) -> None:
    points, erased = outline.points, outline.erased
    if not erased.any():
        canvas.line(list(points), OUTLINE, closed=True)
        return
    for run in runs(erased):
        parts = [run] if not erased[run[0]] else [run[k : k + 2] for k in range(1, len(run), _EVERY)]
        for part in parts:
            canvas.line(list(points[part]), OUTLINE)


def _lengths(canvas: _Canvas, detection: Detection, nose: float, end: float) -> None:
    """Draw L_z above the axis, L_a below it and the rear, from the distances of the ends along the flow."""
    walls, axis = detection.located()[0], detection.axis
    downstream, aside = (detection.flow or 1) * walls.along, 6.0 * walls.across
    tip = axis + nose * downstream
    canvas.arrow(axis - end * downstream - aside, tip - aside, EXTENT)
    if detection.rear is not None and (line := detection.rear_line()) is not None:
        canvas.line(list(line), REAR)
        canvas.arrow(axis + (detection.rear.depth - end) * downstream + aside, tip + aside, LENGTH)
