"""A contour that another program traced: points in pixels or micrometres in a text file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import read_bytes

UNITS = ("px", "um")
_HEADINGS = (("px", "x_px", "y_px"), ("um", "x_um", "y_um"), (None, "x", "y"))
_FEWEST = 16
_MOST_SIDES = 1000  # compared with each other
_NEIGHBOURS = 4  # sides that noise may make cross


@dataclass(frozen=True, eq=False)
class ContourFile:
    """Points of a closed contour.

    Parameters
    ----------
    points : (n, 2) array
        Columns (x, y), x along the channel.
    unit : str
        ``"px"`` or ``"um"``.
    source, sha256 : str
        File and its hash.
    """

    points: Floats
    unit: str
    source: str
    sha256: str

    @classmethod
    def read(cls, path: str | Path, unit: str | None = None) -> ContourFile:
        """Read a CSV file, or the text file that ImageJ saves XY coordinates to.

        Parameters
        ----------
        path : path
            File with the columns ``x_px`` and ``y_px``, or ``x_um`` and ``y_um``, among others; or with ``X`` and
            ``Y`` or two columns without a heading, which need `unit`.
        unit : str, optional
            ``"px"`` or ``"um"``.

        Raises
        ------
        InputError
            Naming file, column, what was expected and what was found.
        """
        where, raw = str(path), read_bytes(path, "file of points")
        try:
            text = raw.decode("utf-8-sig").replace(",", " ").replace(";", " ")
        except UnicodeDecodeError as error:
            raise InputError(where, "", "a readable text file of points", str(error)) from None
        lines = [line for line in text.splitlines() if line.strip()]
        if not lines:
            raise InputError(where, "", "a file of points", "an empty file")
        columns, stated = _columns(lines[0].split(), where)
        unit = stated or unit
        if unit not in UNITS:
            raise InputError(where, "unit", "columns x_px, y_px or x_um, y_um, or the unit px or um", repr(unit))
        points = _points(lines[0 if columns is None else 1 :], columns or (0, 1), where)
        return cls(points, unit, where, hashlib.sha256(raw).hexdigest())


def _columns(first: list[str], where: str) -> tuple[tuple[int, int] | None, str | None]:
    """Return the numbers of the columns x and y and their unit, or None if the first line holds numbers."""
    names = [name.strip('"').lower() for name in first]
    for unit, x, y in _HEADINGS:
        if x in names and y in names:
            return (names.index(x), names.index(y)), unit
    try:
        [float(name) for name in first]
    except ValueError:
        raise InputError(where, "columns", "x_px, y_px or x_um, y_um", ", ".join(first)) from None
    return None, None


def _points(lines: list[str], columns: tuple[int, int], where: str) -> Floats:
    try:
        points = np.loadtxt(lines, usecols=columns, comments=None, ndmin=2) if lines else np.empty((0, 2))
    except ValueError:
        raise InputError(where, "points", "two numbers in each line", "a line without them") from None
    if len(points) and np.array_equal(points[0], points[-1]):
        points = points[:-1]
    if len(points) < _FEWEST or not np.isfinite(points).all():
        raise InputError(where, "points", f"at least {_FEWEST} finite points", f"{len(points)} points")
    if _crosses_itself(points):
        raise InputError(where, "points", "a contour that does not cross itself", "one that does")
    return points


def _crosses_itself(points: Floats) -> bool:
    """Return True if two sides of a polygon cross that are not close along it; of many points, some are omitted."""
    starts = points[:: -(-len(points) // _MOST_SIDES)]
    sides = np.roll(starts, -1, axis=0) - starts
    apart = starts[None] - starts[:, None]
    of_start = np.sign(sides[:, None, 0] * apart[:, :, 1] - sides[:, None, 1] * apart[:, :, 0])
    opposite = of_start * np.roll(of_start, -1, axis=1) < 0.0
    distance = np.abs(np.subtract.outer(np.arange(len(starts)), np.arange(len(starts))))
    far = np.minimum(distance, len(starts) - distance) > _NEIGHBOURS
    return bool((opposite & opposite.T & far).any())
