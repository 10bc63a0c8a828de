"""A contour that a person or another program traced: points in a text file, a file of ImageJ or one of LabelMe."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import read_bytes

UNITS = ("px", "um")
_HEADINGS = (("px", "x_px", "y_px"), ("um", "x_um", "y_um"), (None, "x", "y"))
_FEWEST = 16
_MOST_SIDES = 1000  # compared with each other
_NEIGHBOURS = 4  # sides that noise may make cross
# of an ImageJ ROI: types of closed lines, places of its parts, flag and first version of points as floats
_CLOSED, _OPTIONS, _POINTS, _SUB_PIXEL, _WITH_FLOATS = (0, 7, 8), 50, 64, 128, 222


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
    along_borders : bool
        True if whole numbers are known to be borders between pixels, not centres of pixels.
    """

    points: Floats
    unit: str
    source: str
    sha256: str
    along_borders: bool = False

    @classmethod
    def read(cls, path: str | Path, unit: str | None = None) -> ContourFile:
        """Read a CSV file, the text file or the ROI that ImageJ saves, or the JSON file of LabelMe.

        Parameters
        ----------
        path : path
            File with the columns ``x_px`` and ``y_px``, or ``x_um`` and ``y_um``, among others; or with ``X`` and
            ``Y`` or two columns without a heading, which need `unit`. Or an ImageJ file ``.roi`` of a polygon or a
            freehand or traced line; or a LabelMe file ``.json`` with one polygon; both are in pixels.
        unit : str, optional
            ``"px"`` or ``"um"``.

        Raises
        ------
        InputError
            Naming file, column, what was expected and what was found.
        """
        where, raw = str(path), read_bytes(path, "file of points")
        sha256, suffix = hashlib.sha256(raw).hexdigest(), Path(path).suffix.lower()
        if suffix in _DRAWN:
            if unit not in (None, "px"):
                raise InputError(where, "unit", f"px, in which a {suffix} file is", repr(unit))
            return cls(_checked(_DRAWN[suffix](raw, where), where), "px", where, sha256, along_borders=True)
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
        return cls(points, unit, where, sha256)


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
    return _checked(points, where)


def _checked(points: Floats, where: str) -> Floats:
    if len(points):  # a point clicked twice, or the first one again
        points = points[np.any(points != np.roll(points, 1, axis=0), axis=1)]
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


def _of_imagej(raw: bytes, where: str) -> Floats:
    """Return the points of a polygon, freehand or traced ROI.

    References
    ----------
    `ij.io.RoiDecoder` of ImageJ: big-endian; version at 4, type at 6, top and left at 8 and 10, number of points at 16,
    options at 50; from 64 on the columns and rows less left and top in two bytes each, then, if the options say so,
    both as floats.
    """
    try:
        magic, version, kind, top, left, count = struct.unpack_from(">4shBx2h4xH", raw)
        (options,) = struct.unpack_from(">h", raw, _OPTIONS)
        if magic != b"Iout" or kind not in _CLOSED:
            got = "another file" if magic != b"Iout" else f"a ROI of type {kind}"
            raise InputError(where, "", "an ImageJ polygon, freehand or traced ROI", got)
        if options & _SUB_PIXEL and version >= _WITH_FLOATS:
            pairs = np.frombuffer(raw, ">f4", 2 * count, _POINTS + 4 * count).reshape(2, count)
            return pairs.T.astype(np.float64)
        pairs = np.frombuffer(raw, ">i2", 2 * count, _POINTS).reshape(2, count)
    except (struct.error, ValueError):
        raise InputError(where, "", "an ImageJ ROI", "a file that cannot be read as one") from None
    return pairs.T.astype(np.float64) + np.array([left, top])


def _of_labelme(raw: bytes, where: str) -> Floats:
    """Return the points of the one polygon of a LabelMe file."""
    try:
        content: Any = json.loads(raw)
        polygons = [shape for shape in content["shapes"] if shape.get("shape_type", "polygon") == "polygon"]
        if len(polygons) == 1:
            return np.array([[float(x), float(y)] for x, y in polygons[0]["points"]]).reshape(-1, 2)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError(where, "", "a LabelMe file with a polygon", "a file that cannot be read as one") from None
    labels = ", ".join(str(shape.get("label"))[:40] for shape in polygons[:8]) or "none"
    raise InputError(where, "shapes", "one polygon, the contour", labels, "remove the others")


_DRAWN = {".roi": _of_imagej, ".json": _of_labelme}
