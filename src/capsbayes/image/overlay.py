"""Overlay of a detection on its picture: walls, outline, the two lengths and the rear band, with a legend and a bar."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
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
DOUBT, PREDICTED = (0, 200, 255), (255, 180, 50)
_NAMES = {WALL: "wall", OUTLINE: "edge", EXTENT: "$L_z$", LENGTH: "$L_a$", REAR: "concave rear", DOUBT: "in doubt"}
_NAMES |= {PREDICTED: "predicted"}
_IN_LINE = 3  # names of the legend
_BAR = 0.15  # of the picture's width, at most
_LETTERS, _LEAST_LETTER = 36, 11  # in a line, so that they are 10 px high on a phone; px


def overlay(
    picture: Picture, detection: Detection, half_width: float | None = None, predicted: Floats | None = None
) -> NDArray[np.uint8]:
    """Draw a detection over its picture, s times as large, above a legend : (rows, s columns, 3) array, as in OpenCV.

    Its bar is in micrometres where the half width [m] is given, else in pixels; an outline (p, 2) [px] is predicted.
    """
    # Stated walls are dashed and their axis dotted; a dark line that such a wall lies off is dashed yellow. Erased
    # stretches of the outline are dotted, the dark blob of a refused capsule is outlined in yellow.
    grey = _stretched(picture)
    scale = int(np.clip(math.isqrt(_MOST_DRAWN // grey.size), 1, _LARGEST_SCALE))
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    canvas = _Canvas(np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR), dtype=np.uint8), scale)
    pixels, unit = 1.0, "px"
    if (walls := detection.walls) is not None:
        _walls(canvas, walls, picture.shape[1])
        if half_width is not None:
            pixels, unit = 1e-6 * walls.half_width / half_width, "µm"
    if predicted is not None:
        canvas.line(list(predicted), PREDICTED, closed=True, breadth=scale)
    if detection.outline is not None:
        _outline(canvas, detection.outline)
    elif detection.blob is not None:
        canvas.line(list(detection.blob.polygon), DOUBT, closed=True)
    if detection.nose is not None:
        _lengths(canvas, detection, detection.nose.distance)
    length = round_length(_BAR * picture.shape[1] / pixels)
    return canvas.above_legend(f"{length:g} {unit}", round(scale * length * pixels))


def round_length(most: float) -> float:
    """Return the largest length of one digit, 1, 2 or 5, up to another."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= most)


def png_of(picture: Picture, *, widest: int) -> bytes:
    """Return a picture alone as a PNG file; see `png`."""
    return png(_stretched(picture), widest=widest)


def png(pixels: NDArray[np.uint8], *, widest: int = 2 * _MOST_DRAWN) -> bytes:
    """Return pixels as a PNG file, made smaller where a side is longer than `widest` pixels."""
    scale = min(1.0, widest / max(pixels.shape))
    small = pixels if scale == 1.0 else cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".png", small)[1].tobytes()


def _stretched(picture: Picture) -> NDArray[np.uint8]:
    """Return grey levels from the darkest pixel to the brightest as 0 to 255."""
    low, high = float(picture.grey.min()), float(picture.grey.max())
    return np.asarray(cv2.convertScaleAbs(picture.grey - low, alpha=255.0 / max(high - low, 1e-9)), dtype=np.uint8)


def write_overlay(path: Path, picture: Picture, detection: Detection, half_width: float | None = None) -> None:
    """Draw an overlay and write it as a PNG file."""
    write_file(path, png(overlay(picture, detection, half_width)))


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A picture `scale` times as large, on which lines are drawn between points of the picture."""

    pixels: NDArray[np.uint8]
    scale: int
    used: set[Colour] = field(default_factory=set)

    @property
    def letter(self) -> int:
        """Height of the letters [px]."""
        return max(self.pixels.shape[1] // _LETTERS, _LEAST_LETTER)

    def line(self, points: list[Floats], colour: Colour, *, closed: bool = False, breadth: int = 1) -> None:
        drawn = self.scale * (np.array(points) + 0.5) - 0.5
        fixed = np.rint(drawn * 2**_SHIFT).astype(np.int32)  # OpenCV's numbers for fractions of a pixel
        cv2.polylines(self.pixels, [fixed], closed, colour, breadth, cv2.LINE_AA, _SHIFT)
        self.used.add(colour)

    def above_legend(self, words: str, bar: int) -> NDArray[np.uint8]:
        """Return the picture above the names of the colours that were used, and a bar with words."""
        lines = [(name, colour, 2 * self.letter) for colour, name in _NAMES.items() if colour in self.used]
        lines.append((words, (0, 0, 0), bar))
        size, width = 2 * self.letter, self.pixels.shape[1]
        strip = np.full((size * -(-len(lines) // _IN_LINE), width, 3), 255, dtype=np.uint8)
        for number, (name, colour, length) in enumerate(lines):
            row, column = number // _IN_LINE * size + size // 2, number % _IN_LINE * width // _IN_LINE + size // 4
            cv2.line(strip, (column, row), (column + length, row), colour, max(size // 12, 1))
            _write(strip, name, self.letter, (column + length + size // 4, row), (0, 0, 0))
        return np.vstack([self.pixels, strip])

    def arrow(self, start: Floats, stop: Floats, colour: Colour) -> None:
        along = (stop - start) / np.hypot(*(stop - start))
        across = np.array([-along[1], along[0]])
        self.line([start, stop], colour)
        for end, sense in ((start, 1.0), (stop, -1.0)):
            self.line([end + sense * 3.0 * along + across, end, end + sense * 3.0 * along - across], colour)


@lru_cache
def _ink(words: str, letter: int) -> NDArray[np.uint8]:
    """Return words, with symbols between dollar signs as in figures : (rows, columns) array, 255 where ink is."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import MathTextParser

    return np.asarray(MathTextParser("agg").parse(words, dpi=72, prop=FontProperties(size=letter)).image)


def _write(pixels: NDArray[np.uint8], words: str, letter: int, at: tuple[int, int], colour: Colour) -> None:
    """Write words on white to the right of a column and row."""
    ink = _ink(words, letter)
    column, row = max(at[0], 0), max(at[1] - len(ink) // 2, 0)
    part = pixels[row : row + len(ink), column : column + ink.shape[1]]
    part[:] = 255 - np.rint(ink[: len(part), : part.shape[1], None] / 255.0 * np.subtract(255, colour))


def _walls(canvas: _Canvas, walls: WallLines, columns: int) -> None:
    walls = walls.centred_at(0.5 * (columns - 1))
    reach = 0.6 * columns
    wall, (dash, gap) = walls.half_width, _DASHES if walls.stated else (2.0 * reach, 0.0)
    lines = [(-wall, dash, gap, WALL), (wall, dash, gap, WALL), *([(0.0, *_DOTS, WALL)] if walls.stated else [])]
    sides = zip((-1.0, 1.0), walls.off_band, strict=True)
    lines += [(side * (wall - off), *_DASHES, DOUBT) for side, off in sides if off]
    for place, drawn, skipped, colour in lines:
        start = walls.middle + place * walls.across
        for first in np.arange(-reach, reach, drawn + skipped):
            canvas.line([start + end * walls.along for end in (first, first + drawn)], colour)


def _outline(canvas: _Canvas, outline: EdgeOutline) -> None:
    points, erased = outline.points, outline.erased
    for run in runs(erased):
        parts = [run] if not erased[run[0]] else [run[k : k + 2] for k in range(1, len(run), _EVERY)]
        for part in parts:
            canvas.line(list(points[part]), OUTLINE, closed=not erased.any())


def _lengths(canvas: _Canvas, detection: Detection, nose: float) -> None:
    """Draw L_z above the axis, L_a on it, and the rear where it ends; the nose is at a distance along the flow."""
    walls, letter = detection.located()[0], canvas.letter
    downstream = (detection.flow or 1) * walls.along
    tip = detection.axis + nose * downstream
    if (line := detection.rear_line()) is not None:
        canvas.line(list(line), REAR, breadth=canvas.scale)
    drawn = ("z", EXTENT, 6.0, -1), ("a", LENGTH, 0.0, 1)
    lengths = zip(drawn, detection.lengths[:2], detection.factors, strict=True)
    for (name, colour, aside, side), length, factor in lengths:
        if np.isfinite(length):
            stop = tip - aside * walls.across
            start = stop - length / factor * downstream
            canvas.arrow(start, stop, colour)
            column, row = np.rint(canvas.scale * 0.5 * (start + stop)).astype(int)
            at = column - 3 * letter, row + side * letter
            _write(canvas.pixels, rf"$L_{name} = {length / walls.half_width:.3f}\,\ell$", letter, at, colour)
