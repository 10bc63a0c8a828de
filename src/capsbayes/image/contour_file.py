"""From a contour that another program drew to a measurement: points in pixels or micrometres in a text file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.measure import FLOWS, check_flow, measurement_of_lengths
from capsbayes.measurement import Measurement
from capsbayes.profile import Profile, signed_area, vertex_normals
from capsbayes.quantity import Quantity

__all__ = ["ContourFile", "measure_contour"]

Floats = NDArray[np.float64]

POINTS = ("centres", "borders")
UNITS = ("px", "um")
_HALF_PIXEL = 0.45  # px: how far inside the edge a polygon through the centres of the outermost pixels lies, on average
_CONCAVE = 3.0  # of the edge's error: a rear that is hollow by more is taken to have been traced
_FEWEST = 16


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
        File and its fingerprint.
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
            With columns ``x_px`` and ``y_px``, or ``x_um`` and ``y_um``, among others; or ``X`` and ``Y``, or two
            columns without a heading, whose unit is then asked for.
        unit : str, optional
            ``"px"`` or ``"um"``.

        Returns
        -------
        ContourFile

        Raises
        ------
        InputError
            Naming file, column, what was expected and what was found.
        """
        where = str(path)
        try:
            raw = Path(path).read_bytes()
            lines = [line for line in raw.decode("utf-8-sig").splitlines() if line.strip()]
        except FileNotFoundError:
            raise InputError(where, "", "a file of points", "nothing there") from None
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(where, "", "a readable text file of points", str(error)) from None
        rows = [line.replace(",", " ").replace(";", " ").split() for line in lines]
        if not rows:
            raise InputError(where, "", "a file of points", "an empty file")
        columns, found = _columns(rows[0], where)
        unit = found or unit
        if unit not in UNITS:
            raise InputError(where, "unit", "columns x_px, y_px or x_um, y_um, or the unit px or um", repr(unit))
        return cls(
            _numbers(rows[0 if columns is None else 1 :], columns or (0, 1), where),
            unit,
            where,
            hashlib.sha256(raw).hexdigest(),
        )


def measure_contour(
    contour: ContourFile,
    experiment: Experiment,
    *,
    capsule_velocity: Quantity,
    edge_error: Quantity,
    flow: str,
    pixel_size: Quantity | None = None,
    points: str | None = None,
) -> Measurement:
    """Measure a contour.

    Parameters
    ----------
    contour : ContourFile
    experiment : Experiment
    capsule_velocity : Quantity [m/s]
        v_o with its standard error.
    edge_error : Quantity [m]
        Standard error with which each end of the contour lies on the edge; its value is used, not its error.
    flow : str
        ``"right"`` or ``"left"``.
    pixel_size : Quantity, optional [m]
        Of a contour in pixels, with its standard error.
    points : str, optional
        Whether a contour of whole pixels runs through ``"centres"`` of pixels, half a pixel inside the edge, or along
        their ``"borders"``.

    Returns
    -------
    Measurement
        In metres. L_a is that of the contour where its rear is concave by more than three errors of the edge;
        otherwise it is missing, as the rim may hide a concave rear, and has an upper bound.

    Raises
    ------
    InputError
        If something is missing that the file does not say.
    """
    direction = FLOWS[flow] if check_flow(flow) else 1
    size, outline = _edge(contour, pixel_size, points)
    z, y = direction * outline[:, 0], outline[:, 1]
    centred = np.stack([z, y - 0.5 * (y.max() + y.min())], axis=1)
    profile = Profile.from_outline(centred)
    error = edge_error.value / size.value
    depth = profile.parachute_depth if profile.parachute_depth > _CONCAVE * error else np.nan
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = error**2 * np.array([[2.0, 1.0], [1.0, 2.0]])  # the nose is an end of both
    named = Path(experiment.source) if experiment.source else None
    return measurement_of_lengths(
        np.array([profile.axial_extent, profile.axial_extent - depth, depth, np.nan]),
        covariance,
        capsule_velocity,
        pixel_size=size,
        source=contour.source,
        sha256=contour.sha256,
        experiment_file=named,
    )


def _edge(contour: ContourFile, pixel_size: Quantity | None, points: str | None) -> tuple[Quantity, Floats]:
    """The length of the unit of the contour, and the outline in it."""
    outline = contour.points if signed_area(contour.points) > 0.0 else contour.points[::-1]
    if contour.unit == "um":
        return Quantity(1e-6, 0.0, "m"), outline
    if pixel_size is None or pixel_size.error == 0.0:
        raise InputError(contour.source, "pixel size", "one with an error for points in pixels", "nothing")
    whole = np.array_equal(outline, np.rint(outline))
    if whole and points not in POINTS:
        expected = "whether these whole pixels are centres of pixels or borders between them"
        raise InputError(contour.source, "points", expected, repr(points), "say centres or borders")
    if points == "centres":
        outline = outline + _HALF_PIXEL * vertex_normals(outline)
    return pixel_size, outline


def _columns(first: list[str], where: str) -> tuple[tuple[int, int] | None, str | None]:
    """Places of x and y in a line of headings and their unit, or None for a line of numbers."""
    names = [name.strip('"').lower() for name in first]
    for unit, x, y in (("px", "x_px", "y_px"), ("um", "x_um", "y_um"), (None, "x", "y")):
        if x in names and y in names:
            return (names.index(x), names.index(y)), unit
    try:
        [float(name) for name in first]
    except ValueError:
        raise InputError(where, "columns", "x_px, y_px or x_um, y_um", ", ".join(first)) from None
    return None, None


def _numbers(rows: list[list[str]], columns: tuple[int, int], where: str) -> Floats:
    try:
        points = np.array([[float(row[column]) for column in columns] for row in rows])
    except (ValueError, IndexError):
        raise InputError(where, "points", "two numbers in each line", "a line without them") from None
    if len(points) and np.array_equal(points[0], points[-1]):
        points = points[:-1]
    if len(points) < _FEWEST or not np.isfinite(points).all():
        raise InputError(where, "points", f"at least {_FEWEST} finite points", f"{len(points)} points")
    return points
