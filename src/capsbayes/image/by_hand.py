"""What a person states of a picture: a part of it, the walls, or the size of a pixel and the axis, contrast and gamma.

Places are in pixels of the whole picture, columns x to the right and rows y down; the middle of the first pixel is at
(0, 0). ImageJ counts from the corner of the first pixel: its numbers are larger by 0.5.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.image.background import CONTRASTS
from capsbayes.image.files import SMALLEST_SIDE
from capsbayes.image.walls import WallLines
from capsbayes.quantity import Given, Quantity, uncertain

WALL_ERROR = 1.0  # px: of a wall placed by hand, whose line is some pixels wide, unless another error is stated
_LINE = 2.0  # px: standard deviation of the dark line of a wall that was not fitted, as of a bundle of thin lines
_LARGEST_OFFSET = 3.0  # px
_TAPER = 0.1  # largest relative difference of the distances between the walls at the two borders
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?", re.IGNORECASE)

_MOST_GAMMA = 4.0  # cameras and displays have up to 2.6
_GAMMA = f'a number above 0, at most {_MOST_GAMMA:g}, as "2.2"'
_FORMS: tuple[tuple[str, tuple[int, ...], str], ...] = (
    (
        "walls",
        (2, 4),
        'the rows of two walls in px, as "12.5, 187.0", or those of each at the left and the right border, as '
        '"12.5 15.0, 187.0 189.5"',
    ),
    ("axis", (1, 2), 'the row of the axis in px, as "99.5", or its rows at the left and the right border, as "98 101"'),
    ("crop", (4,), 'left column, upper row, width and height in px, as "40, 0, 220, 200"'),
    ("wall_error", (1,), 'one number of px, as "1.0"'),
    ("gamma", (1,), _GAMMA),
)
_BOXES = 'left column, upper row, width and height of each box in px, as "40, 0, 22, 20; 90, 60, 12, 9"'

_LINES = ("walls", "axis")
_TURNS = ("90", "180", "270")


@dataclass
class ByHand:
    """What is stated of a picture by hand; what is not stated is found in the picture.

    Parameters
    ----------
    walls : text or sequence of float, optional [px]
        Rows of the upper and the lower wall, as ``"12.5, 187.0 px"``; of tilted walls, the rows of each at the left
        and the right border of the picture, as ``"12.5 15.0, 187.0 189.5 px"``. A wall is the middle of its dark line.
    wall_error : text or float, optional [px]
        Standard error of either wall; `WALL_ERROR` by default.
    pixel_size : Quantity, optional [m]
        With its standard error, in place of walls: l in pixels is then the half width over it.
    axis : text or sequence of float, optional [px]
        With a pixel size, the row of the channel's axis, or its rows at the left and the right border; by default the
        axis is the middle row of the picture, or of the part of it that is cut out.
    crop : text or sequence of float, optional [px]
        Left column, upper row, width and height of the part of the picture that is analysed.
    erase : text or sequence of float, optional [px]
        Left column, upper row, width and height of boxes within which the outline is wrong, as ``"40, 0, 22, 20"``;
        further boxes follow after a semicolon. There the outline is a smooth curve between what is left of it.
    contrast : str, optional
        ``"dark"`` or ``"bright"``, as capsule and walls are compared with the liquid; by default the picture tells it.
    edge_offset : Quantity, optional [px]
        How far outside the edge that is located the true one lies, with its standard error, as ``"0.12 +/- 0.05 px"``,
        if it was measured, as by `capsbayes.image.edge_offset_of`; where the membrane is seen as a line, from the
        middle of the line. By default it is zero, with an error that grows with blur and rings of light.
    rotate : text or int, optional [degree]
        90, 180 or 270: the picture is turned clockwise by so much before all else, and its background with it; the flow
        must run along the rows. All places are those of the turned picture.
    gamma : text or float, optional
        The grey levels are the light to the power of 1 / gamma: picture and background are made linear before all else.

    Raises
    ------
    InputError
        If a text is not such numbers, or two of them contradict each other.

    Examples
    --------
    >>> ByHand(walls="12.5, 187.0 px").walls
    (12.5, 12.5, 187.0, 187.0)
    >>> ByHand(pixel_size="0.34 +/- 0.003 um", axis=(98.0, 101.0)).pixel_size.error
    3e-09
    """

    walls: Any = None
    wall_error: Any = None
    pixel_size: Given | None = None
    axis: Any = None
    crop: Any = None
    erase: Any = None
    contrast: str | None = None
    edge_offset: Any = None
    rotate: Any = None
    gamma: Any = None

    def __post_init__(self) -> None:
        for name, counts, expected in _FORMS:
            numbers = _numbers(getattr(self, name), name.replace("_", " "), counts, expected)
            if numbers is not None and name in _LINES and len(numbers) == counts[0]:
                numbers = tuple(np.repeat(numbers, 2).tolist())  # along the rows: at both borders the same
            setattr(self, name, numbers)
        self.erase = _boxes(self.erase)
        if self.gamma is not None:
            (self.gamma,) = self.gamma
            if not 0.0 < self.gamma <= _MOST_GAMMA:
                raise InputError("gamma", "", _GAMMA, f"{self.gamma:g}")
        if self.contrast is not None and self.contrast not in CONTRASTS:
            raise InputError("contrast", "", " or ".join(f'"{name}"' for name in CONTRASTS), repr(self.contrast))
        if self.rotate is not None and str(self.rotate) not in _TURNS:
            raise InputError("rotate", "", f"{', '.join(_TURNS)} degrees clockwise", repr(self.rotate))
        if self.pixel_size is not None:
            self.pixel_size = length(self.pixel_size, "pixel size", "0.340 +/- 0.003 um")
        if self.edge_offset is not None:
            given = self.edge_offset
            given = given.strip().removesuffix("px") if isinstance(given, str) else given
            example = "0.12 +/- 0.05 px"
            self.edge_offset = uncertain(
                given, where="edge offset", units=("",), example=example, signed=True, normal=False
            )
            if not abs(self.edge_offset.mean) + self.edge_offset.sd < _LARGEST_OFFSET:
                raise InputError("edge offset", "", f"less than {_LARGEST_OFFSET:g} px", str(self.edge_offset))
        if self.walls is not None and self.pixel_size is not None:
            raise InputError("walls, pixel size", "", "one of the two: each of them gives l in pixels", "both")
        if self.axis is not None and self.pixel_size is None:
            expected = "a pixel size with it: walls that are found or stated have their own axis"
            raise InputError("axis", "", expected, "none")
        if self.wall_error is not None and not (self.walls is not None and self.wall_error[0] > 0.0):
            given = "no walls" if self.walls is None else f"{self.wall_error[0]:g}"
            raise InputError("wall error", "", "a positive number of px, for walls that are stated", given)

    @property
    def quarters(self) -> int:
        """By how many quarters a picture is turned clockwise."""
        return 0 if self.rotate is None else int(self.rotate) // 90

    def part(self, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Return the rows and columns that are analysed of a picture of a shape."""
        rows, columns = shape
        if self.crop is None:
            return slice(0, rows), slice(0, columns)
        left, top, width, height = map(round, self.crop)
        right, bottom = left + width, top + height
        if left < 0 or top < 0 or right > columns or bottom > rows:
            raise InputError("crop", "", f"a part of the picture of {columns} x {rows} px", _listed(self.crop))
        if min(width, height) < SMALLEST_SIDE:
            raise InputError("crop", "", f"at least {SMALLEST_SIDE} x {SMALLEST_SIDE} px", f"{width} x {height} px")
        return slice(top, bottom), slice(left, right)

    def erased_in_part(self, shape: tuple[int, int]) -> Floats | None:
        """Return left, upper, right and lower limit of the boxes to erase in the part : (k, 4) array."""
        if self.erase is None:
            return None
        rows, columns = self.part(shape)
        corners = []
        for left, top, width, height in self.erase:
            if left >= shape[1] or top >= shape[0] or left + width <= 0.0 or top + height <= 0.0:
                expected = f"a box within the picture of {shape[1]} x {shape[0]} px"
                raise InputError("erase", "", expected, _listed((left, top, width, height)))
            corners.append((left, top, left + width, top + height))
        return np.array(corners) - 0.5 - np.array(2 * [columns.start, rows.start])

    def lines(self, shape: tuple[int, int], half_width: Quantity | None) -> WallLines | None:
        """Return the walls in the part that is analysed of a picture of a shape; None where they are to be found."""
        if self.walls is not None:
            stated = self._stated_walls(shape)
        elif self.pixel_size is not None:
            stated = self._around_axis(shape, self.pixel_size, half_width)
        else:
            return None
        rows, columns = self.part(shape)
        return stated.moved(-columns.start, -rows.start).centred_at(0.5 * (columns.stop - columns.start - 1))

    def _stated_walls(self, shape: tuple[int, int]) -> WallLines:
        rows, columns = shape
        upper, lower = sorted(np.reshape(self.walls, (2, 2)), key=np.mean)
        apart, middle = lower - upper, 0.5 * (upper + lower)
        if np.any(apart <= 0.0):
            raise InputError("walls", "", "two walls that do not cross in the picture", _listed(self.walls))
        if np.ptp(apart) > _TAPER * apart.mean():
            got = f"{apart[0]:g} px apart at the left border and {apart[1]:g} px at the right one"
            raise InputError("walls", "", "two parallel walls", got)
        for row in (upper.mean(), lower.mean()):
            _check_row(row, rows, "walls")
        error = WALL_ERROR if self.wall_error is None else self.wall_error[0]
        # lines that open: l at a capsule anywhere between the borders is that in the middle, to this error
        opening = 0.5 * np.ptp(apart) / np.sqrt(12.0)
        across = np.cos(np.arctan(np.ptp(middle) / (columns - 1.0)))
        half_width, its_error = 0.5 * across * apart.mean(), across * np.hypot(error / np.sqrt(2.0), opening)
        stated = f"walls by hand at rows {_listed(self.walls)} px, each +/- {error:g} px"
        return _around_rows(middle, columns, half_width, its_error, stated)

    def _around_axis(self, shape: tuple[int, int], size: Quantity, half_width: Quantity | None) -> WallLines:
        if half_width is None:
            raise InputError("half width", "", "that of the channel, which turns a pixel size into l", "nothing")
        rows, columns = shape
        if self.axis is None:
            within = self.part(shape)[0]
            left = right = 0.5 * (within.start + within.stop - 1)
        else:
            left, right = self.axis
        _check_row(0.5 * (left + right), rows, "axis")
        l_px = half_width.mean / size.value
        error = l_px * np.hypot(size.error / size.value, half_width.sd / half_width.mean)
        stated = f"the half width over a pixel of {1e6 * size.value:.4g} +/- {1e6 * size.error:.2g} um"
        return _around_rows(np.array([left, right]), columns, l_px, error, stated)


def _around_rows(axis: Floats, columns: int, half_width: float, error: float, stated: str) -> WallLines:
    """Return the walls around an axis by its rows at the left and the right border."""
    tilt = float(np.arctan2(axis[1] - axis[0], columns - 1.0))
    return WallLines(float(axis.mean()), 0.5 * (columns - 1), tilt, float(half_width), float(error), _LINE, stated)


def length(given: object, where: str, example: str) -> Quantity:
    """Return a length [m] that needs a standard error."""
    return uncertain(given, where=where, units=("m",), example=example, normal=False)


def _numbers(given: Any, name: str, counts: tuple[int, ...], expected: str) -> tuple[float, ...] | None:
    """Return the numbers of a text or a sequence."""
    if given is None:
        return None
    parts, numbers = given, tuple[float, ...]()
    if isinstance(given, str):
        parts = [part for part in re.split(r"[,\s]+", given.strip().removesuffix("px")) if part]
    if not isinstance(given, str) or all(map(_NUMBER.fullmatch, parts)):
        with contextlib.suppress(TypeError, ValueError):
            numbers = tuple(float(part) for part in np.atleast_1d(parts))
    if len(numbers) not in counts or not np.all(np.isfinite(numbers)):
        raise InputError(name, "", expected, repr(given))
    return numbers


def _boxes(given: Any) -> tuple[tuple[float, ...], ...] | None:
    """Return the numbers of boxes, in a text or in one or several sequences of four."""
    if given is None:
        return None
    parts: Any = given if np.iterable(given) else [given]
    if isinstance(given, str):
        parts = [part for part in given.split(";") if part.strip()]
    elif len(parts) == 4 and np.ndim(parts) == 1:
        parts = [given]
    boxes = tuple(_numbers(part, "erase", (4,), _BOXES) or () for part in parts)
    if not boxes or any(not box or min(box[2:]) <= 0.0 for box in boxes):
        raise InputError("erase", "", _BOXES, repr(given))
    return boxes


def _check_row(row: float, rows: int, name: str) -> None:
    if not -0.5 <= row <= rows - 0.5:
        raise InputError(name, "", f"rows within the picture, from 0 to {rows - 1} px", f"{row:g}")


def _listed(numbers: tuple[float, ...]) -> str:
    """Return numbers as text; those of a line with the same row at both borders once."""
    if len(numbers) == 4 and numbers[0] == numbers[1] and numbers[2] == numbers[3]:
        numbers = numbers[::2]
    return ", ".join(f"{number:g}" for number in numbers)
