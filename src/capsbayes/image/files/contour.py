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
from capsbayes.files.csv_file import finite_numbers, read_columns
from capsbayes.files.input_file import parsing, read_bytes
from capsbayes.profile import check_simple

UNITS = ("px", "um")
_HEADINGS = (("px", "x_px", "y_px"), ("um", "x_um", "y_um"), (None, "x", "y"))
_FEWEST = 16
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
            expected, read = _DRAWN[suffix]
            with parsing(where, expected):
                points = read(raw, where)
            return cls(_checked(points, where), "px", where, sha256, along_borders=True)
        table = read_columns(path, "file of points", unnamed=("x", "y"))
        names = {str(name).lower(): str(name) for name in table}
        stated, columns = next(((of, pair) for of, *pair in _HEADINGS if names.keys() >= set(pair)), (None, []))
        if not columns:
            raise InputError(where, "columns", "x_px, y_px or x_um, y_um", ", ".join(names.values()))
        if stated and unit not in (None, stated):
            raise InputError(where, "unit", f"{stated}, which its columns state", repr(unit))
        unit = stated or unit
        if unit not in UNITS:
            expected = "columns x_px, y_px or x_um, y_um, or the unit px or um"
            raise InputError(where, "unit", expected, "none of them" if unit is None else repr(unit))
        points = finite_numbers(table, [names[column] for column in columns], where)
        return cls(_checked(points, where), unit, where, sha256)


def _checked(points: Floats, where: str) -> Floats:
    if len(points):  # a point clicked twice, or the first one again
        points = points[np.any(points != np.roll(points, 1, axis=0), axis=1)]
    for row in np.flatnonzero(~np.isfinite(points).all(axis=1))[:1]:
        raise InputError(where, f"point {row + 1}", "finite coordinates", ", ".join(map(str, points[row])))
    if len(points) < _FEWEST:
        raise InputError(where, "points", f"at least {_FEWEST} points", str(len(points)))
    check_simple(points, where)
    return points


def _of_imagej(raw: bytes, where: str) -> Floats:
    """Return the points of a polygon, freehand or traced ROI.

    References
    ----------
    `ij.io.RoiDecoder` of ImageJ: big-endian; version at 4, type at 6, top and left at 8 and 10, number of points at 16,
    options at 50; from 64 on the columns and rows less left and top in two bytes each, then, if the options say so,
    both as floats.
    """
    magic, version, kind, top, left, count = struct.unpack_from(">4shBx2h4xH", raw)
    (options,) = struct.unpack_from(">h", raw, _OPTIONS)
    if magic != b"Iout" or kind not in _CLOSED:
        got = "another file" if magic != b"Iout" else f"a ROI of type {kind}"
        raise InputError(where, "", "an ImageJ polygon, freehand or traced ROI", got)
    if options & _SUB_PIXEL and version >= _WITH_FLOATS:
        pairs = np.frombuffer(raw, ">f4", 2 * count, _POINTS + 4 * count).reshape(2, count)
        return pairs.T.astype(np.float64)
    pairs = np.frombuffer(raw, ">i2", 2 * count, _POINTS).reshape(2, count)
    return pairs.T.astype(np.float64) + np.array([left, top])


def _of_labelme(raw: bytes, where: str) -> Floats:
    """Return the points of the one polygon of a LabelMe file."""
    content: Any = json.loads(raw)
    polygons = [shape for shape in content["shapes"] if shape.get("shape_type", "polygon") == "polygon"]
    if len(polygons) != 1:
        labels = ", ".join(str(shape.get("label"))[:40] for shape in polygons[:8]) or "none"
        raise InputError(where, "shapes", "one polygon, the contour", labels, "remove the others")
    return np.array([[float(x), float(y)] for x, y in polygons[0]["points"]]).reshape(-1, 2)


_DRAWN = {".roi": ("an ImageJ ROI", _of_imagej), ".json": ("a LabelMe file with a polygon", _of_labelme)}
