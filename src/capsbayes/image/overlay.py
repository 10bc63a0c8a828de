"""Overlay of a detection on its picture: walls, outline, the two lengths and the rear band, with a legend and a bar."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
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
_BLACK, _WHITE = (0, 0, 0), (255, 255, 255)
_BAR = 0.25  # of the picture's width, at most
_LETTERS = 36  # in a line: on a phone they are 10 pixels high
_LEAST_LETTER = 11  # px


def overlay(picture: Picture, detection: Detection, half_width: float | None = None) -> NDArray[np.uint8]:
    """Draw a detection over its picture, s times as large, above a legend : (rows, s columns, 3) array, as in OpenCV.

    Its bar is in micrometres where the half width [m] is given, else in pixels.
    """
    # Stated walls are dashed and their axis dotted; a dark line that such a wall lies off is dashed orange. Erased
    # stretches of the outline are dotted, the dark blob of a refused capsule is outlined in orange.
    grey = _stretched(picture)
    scale = int(np.clip(math.isqrt(_MOST_DRAWN // grey.size), 1, _LARGEST_SCALE))
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    canvas = _Canvas(np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR), dtype=np.uint8), scale)
    legend = {}
    if (walls := detection.walls) is not None:
        legend["wall"] = WALL
        _walls(canvas, walls, picture.shape[1])
        if any(walls.off_band):
            legend["dark line"] = REAR
    if detection.outline is not None:
        legend["edge"] = OUTLINE
        _outline(canvas, detection.outline)
    elif detection.blob is not None:
        legend["dark blob"] = REAR
        canvas.line(list(detection.blob.polygon), REAR, closed=True)
    if detection.nose is not None and detection.end is not None:
        legend |= {"$L_z$": EXTENT} | ({} if detection.rear is None else {"$L_a$": LENGTH, "concave rear": REAR})
        _lengths(canvas, detection, detection.nose.distance, detection.end.distance)
    pixels, unit = 1.0, "px"
    if walls is not None and half_width is not None:
        pixels, unit = 1e-6 * walls.half_width / half_width, "µm"
    length = round_length(_BAR * picture.shape[1] / pixels)
    lines = [(name, colour, 2 * canvas.letter) for name, colour in legend.items()]
    return canvas.above([*lines, (f"{length:g} {unit}", _BLACK, round(scale * length * pixels))])


def round_length(most: float) -> float:
    """Return the largest length of one digit, 1, 2 or 5, up to another."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= most)


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


def write_overlay(path: Path, picture: Picture, detection: Detection, half_width: float | None = None) -> None:
    """Draw an overlay and write it as a PNG file."""
    _, png = cv2.imencode(".png", overlay(picture, detection, half_width))
    write_file(path, png.tobytes())


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A picture `scale` times as large, on which lines are drawn between points of the picture."""

    pixels: NDArray[np.uint8]
    scale: int

    @property
    def letter(self) -> int:
        """Height of the letters [px]."""
        return max(self.pixels.shape[1] // _LETTERS, _LEAST_LETTER)

    def line(self, points: list[Floats], colour: Colour, *, closed: bool = False, breadth: int = 1) -> None:
        drawn = self.scale * (np.array(points) + 0.5) - 0.5
        fixed = np.rint(drawn * 2**_SHIFT).astype(np.int32)  # OpenCV's numbers for fractions of a pixel
        cv2.polylines(self.pixels, [fixed], closed, colour, breadth, cv2.LINE_AA, _SHIFT)

    def text(self, words: str, at: Floats, colour: Colour) -> None:
        """Write words around a point of the picture."""
        ink = _ink(words, self.letter)
        column, row = np.rint(self.scale * (at + 0.5) - 0.5 * np.array(ink.shape[::-1])).astype(int)
        _put(self.pixels, ink, row, column, colour)

    def above(self, lines: list[tuple[str, Colour, int]]) -> NDArray[np.uint8]:
        """Return the picture above a legend, of lines with names, colours and lengths."""
        letter, width = self.letter, self.pixels.shape[1]
        row, column, placed = letter, letter, []
        for name, colour, length in lines:
            ink = _ink(name, letter)
            if column > letter and column + length + letter + ink.shape[1] > width:
                row, column = row + 2 * letter, letter
            placed.append((row, column, length, colour, ink))
            column += length + 2 * letter + ink.shape[1]
        strip = np.full((row + letter, width, 3), _WHITE, dtype=np.uint8)
        for row, column, length, colour, ink in placed:
            cv2.line(strip, (column, row), (column + length, row), colour, max(letter // 6, 1))
            _put(strip, ink, row - ink.shape[0] // 2, column + length + letter // 2, _BLACK)
        return np.vstack([self.pixels, strip])

    def arrow(self, start: Floats, stop: Floats, colour: Colour) -> None:
        along = (stop - start) / np.hypot(*(stop - start))
        across = np.array([-along[1], along[0]])
        self.line([start, stop], colour)
        for end, sense in ((start, 1.0), (stop, -1.0)):
            self.line([end + sense * 3.0 * along + across, end, end + sense * 3.0 * along - across], colour)


@lru_cache
def _ink(words: str, height: int) -> NDArray[np.uint8]:
    """Return words, with symbols between dollar signs, as in figures : (rows, columns) array, 255 where ink is."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import MathTextParser

    return np.asarray(MathTextParser("agg").parse(words, dpi=72, prop=FontProperties(size=height)).image)


def _put(pixels: NDArray[np.uint8], ink: NDArray[np.uint8], row: int, column: int, colour: Colour) -> None:
    """Lay ink with a white rim on pixels, from a row and a column on, or as near as it fits."""
    room = np.subtract(pixels.shape[:2], ink.shape)
    row, column = (max(min(at, most), 0) for at, most in zip((row, column), room, strict=True))
    part = pixels[row : row + ink.shape[0], column : column + ink.shape[1]]
    ink = ink[: part.shape[0], : part.shape[1]]
    for mask, shade in ((cv2.dilate(ink, np.ones((5, 5), dtype=np.uint8)), _WHITE), (ink, colour)):
        weight = mask[..., None] / 255.0
        part[:] = np.rint(weight * shade + (1.0 - weight) * part)


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
    """Draw L_z above the axis, the rear, and L_a on the axis from there; the distances are those of the ends."""
    walls, axis = detection.located()[0], detection.axis
    downstream, aside = (detection.flow or 1) * walls.along, 6.0 * walls.across
    beside = canvas.letter / canvas.scale * walls.across
    tip, extent, length = axis + nose * downstream, detection.lengths[0], detection.lengths[1]
    canvas.arrow(tip - extent * downstream - aside, tip - aside, EXTENT)
    canvas.text(
        rf"$L_z = {extent / walls.half_width:.3f}\,\ell$", tip - 0.5 * extent * downstream - aside - beside, EXTENT
    )
    if detection.rear is not None and (line := detection.rear_line()) is not None:
        canvas.line(list(line), REAR, breadth=canvas.scale)
        canvas.arrow(tip - length * downstream, tip, LENGTH)
        canvas.text(rf"$L_a = {length / walls.half_width:.3f}\,\ell$", tip - 0.5 * length * downstream + beside, LENGTH)
