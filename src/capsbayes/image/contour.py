"""Contours that somebody drew: files and their measurement."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.interpolate import CubicSpline

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Camera, Experiment
from capsbayes.files.csv_file import finite_numbers, read_columns
from capsbayes.files.input_file import parsing, read_bytes
from capsbayes.image.by_hand import ByHand
from capsbayes.image.edge_models import robust_spread
from capsbayes.image.measure import EdgeErrors, asymmetry_of, check_flow, measurement_of_lengths, over_l, speeds_of
from capsbayes.image.walls import WallLines
from capsbayes.measurement import Measurement
from capsbayes.profile import Profile, arc_length, check_simple, signed_area, vertex_normals
from capsbayes.quantity import Given, Quantity

# A contour that a person or another program traced: points in a text file, a file of ImageJ or one of LabelMe

UNITS = ("px", "um")
_HEADINGS = (("px", "x_px", "y_px"), ("um", "x_um", "y_um"), (None, "x", "y"))
_FEWEST = 16
# of an ImageJ ROI: types of closed lines, places of its parts, flag and first version of points as floats
_CLOSED, _OPTIONS, _POINTS, _SUB_PIXEL, _WITH_FLOATS = (0, 7, 8), 50, 64, 128, 222


@dataclass(frozen=True, eq=False)
class ContourFile:
    """Points of a closed contour."""

    points: Floats  # (n, 2): columns (x, y), x along the channel
    unit: str  # ``"px"`` or ``"um"``
    source: str
    sha256: str
    along_borders: bool = False  # true if whole numbers are known to be borders between pixels, not centres of pixels

    @classmethod
    def read(cls, path: str | Path, unit: str | None = None) -> ContourFile:
        """Read a CSV file, the text file or the ROI that ImageJ saves, or the JSON file of LabelMe."""
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
    """Return the points of a polygon, freehand or traced ROI."""
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


# From a contour that a person or another program traced to a measurement with its silhouette

POINTS = ("centres", "borders")
EDGE_ERROR = 1.0  # px: of either end, unless stated: a line may be drawn anywhere in an edge blurred over some pixels
_HALF_PIXEL = 0.45  # px: how far inside the edge a polygon through the centres of the outermost pixels lies, on average
# of the depth's standard error, and of l: a rear that is hollow by more is taken to have been traced; a silhouette is
# hollow by less, and 12 of 60 drawn with an error of a pixel were hollow by more than three errors of the edge
_CONCAVE = 4.0, 0.1
_COMMON = 0.5  # of the variance of the edge's error: alike all around, as of a line drawn too far out everywhere
_DRIFT = 0.5  # l: length along the edge over which the rest of it is alike, as a hand drifts
_MOST_POINTS = 128  # of a silhouette: those of a denser contour are averaged
_SPARSE = 200  # points: a contour of fewer is smoothed by a spline, as its sides cut off the curve
_ROWS = 1_000_000  # of the picture of a contour, whose size is not known: at most
_LONG = 3.0  # times the median side: one that points may be missing on
_MOST_OFF = 0.05  # of the radius, or a pixel: what may lie beyond such a side, or jut out from the rest
_WIDEST, _APART = 3, 24  # points in a spike at most, and of the outline for each of them: a rear is hollow by itself
_OUTLIER = 6.0  # of the scatter: more is no chance
_CORNER = 0.4  # rad: least turn of a contour at a spike, and at a corner from one side of it to the other
_LEAST_NOISE = 1e-4  # of l: no contour is more accurate from point to point


def measure_contour(
    contour: ContourFile,
    experiment: Experiment,
    *,
    capsule_velocity: Given | None,
    flow: str,
    flow_rate: Given | None = None,
    edge_error: Given | None = None,
    pixel_size: Given | None = None,
    points: str | None = None,
    walls: Any = None,
    wall_error: Any = None,
) -> Measurement:
    """Measure a capsule from its contour."""
    direction = check_flow(flow) or 1
    capsule_velocity, rate = speeds_of("measure_contour", capsule_velocity, flow_rate)
    edge_error, pixel_size = (
        None if given is None else Quantity.of(given, where="measure_contour", key=key, units=("m",))
        for given, key in ((edge_error, "edge_error"), (pixel_size, "pixel_size"))
    )
    between = None if walls is None else _between(contour, ByHand(walls=walls, wall_error=wall_error))
    if between is not None:
        size = experiment.half_width.mean / between.half_width
        pixel_size = Quantity(size, size * between.half_width_error / between.half_width, "m")
    unit, edge, error = _edge(contour, direction, edge_error, pixel_size, points)
    aspect, scatter = _aspect(experiment), _scatter(edge)
    edge = edge / [aspect.mean, 1.0]
    half_width = experiment.half_width.mean / unit.value
    of_width = 0.0 if between is not None else experiment.half_width.sd / experiment.half_width.mean
    relative = float(np.hypot(unit.error / unit.value, of_width))
    profile = Profile.from_outline(_smooth(edge))
    own = _missing(contour) ** 2 + _spike(contour) ** 2 + (1.0 - _COMMON) * error**2 + scatter**2
    hollow = max(_CONCAVE[0] * np.sqrt(2.0 * own), _CONCAVE[1] * half_width)
    depth = profile.parachute_depth if profile.parachute_depth > hollow else np.nan
    covariance = np.zeros((4, 4))
    # both lengths end at the nose; what is alike all around moves either end outwards
    covariance[:2, :2] = own * np.array([[2.0, 1.0], [1.0, 2.0]]) + 4.0 * _COMMON * error**2
    covariance[3, 3] = (relative * half_width) ** 2
    lengths = np.array([profile.axial_extent, profile.axial_extent - depth, depth, half_width])
    covariance[:2, :2] += (aspect.sd / aspect.mean) ** 2 * np.outer(lengths[:2], lengths[:2])
    edge = _without_rear(edge, error, hollow=bool(np.isfinite(depth)))
    drift, common = (float(np.sqrt(share)) * error for share in (1.0 - _COMMON, _COMMON))
    errors = EdgeErrors(max(scatter, _LEAST_NOISE * half_width), drift, 0.0, common, alike=_DRIFT * half_width)
    seen = over_l(edge, errors, half_width, relative * half_width)
    if seen is not None and aspect.sd > 0.0:
        seen = replace(seen, pose=replace(seen.pose, pixel_aspect=aspect.sd))
    status, further = asymmetry_of(seen, half_width)
    covariance[:2, :2] += further
    named, size_um = "pixel" if contour.unit == "px" else "unit", 1e6 * unit.value
    return measurement_of_lengths(
        lengths,
        covariance,
        capsule_velocity,
        experiment,
        flow_rate=rate,
        outline=seen,
        status=status,
        walls=between or f"the half width over a {named} of {size_um:.4g} um",
        source=contour.source,
        sha256=contour.sha256,
    )


def _between(contour: ContourFile, stated: ByHand) -> WallLines:
    """Return the walls that are stated around a contour in pixels."""
    upper, lower = sorted(stated.walls[::2])
    if stated.walls[0] != stated.walls[1] or stated.walls[2] != stated.walls[3]:
        expected = "two rows: a contour does not tell the borders of its picture, at which tilted walls are stated"
        raise InputError("walls", "", expected, "four")
    if contour.unit != "px":
        raise InputError("walls", "", "a contour in pixels, as the walls are", f"{contour.source} in {contour.unit}")
    rows = contour.points[:, 1]
    if not upper < rows.min() < rows.max() < lower:
        expected = f"one wall on either side of the contour, whose rows are {rows.min():.4g} to {rows.max():.4g} px"
        raise InputError("walls", "", expected, f"{upper:g}, {lower:g}")
    between = stated.lines((_ROWS, _ROWS), None)
    assert between is not None, "walls are stated"
    return between


def _aspect(experiment: Experiment) -> Quantity:
    """Return the height of a pixel over its width; refuse what needs the place of the contour in its picture."""
    camera = experiment.camera or Camera()
    if others := [name for name in camera.stated if name != "pixel_aspect"]:
        expected = "pixel_aspect alone for a contour, which does not tell where the middle of its picture is"
        raise InputError(experiment.source or "experiment", "camera", expected, ", ".join(others))
    return camera.pixel_aspect


def _without_rear(points: Floats, error: float, *, hollow: bool) -> Floats:
    """Return not too many points of a silhouette, without those of a rear that is seen through its rim."""
    group = -(-len(points) // _MOST_POINTS)
    points = points[: len(points) // group * group].reshape(-1, group, 2).mean(axis=1)
    if not hollow:
        return points
    hull: Any = shapely.convex_hull(shapely.multipoints(points))
    return np.asarray(points[shapely.distance(shapely.points(points), hull.exterior) < error])


def _edge(
    contour: ContourFile, direction: int, edge_error: Quantity | None, pixel_size: Quantity | None, points: str | None
) -> tuple[Quantity, Floats, float]:
    """Return unit, edge clockwise on its axis with the flow along z, and the error of either end in that unit."""
    outline = contour.points if signed_area(contour.points) > 0.0 else contour.points[::-1]
    if contour.unit == "um":
        unit = Quantity(1e-6, 0.0, "m")
        if edge_error is None:
            expected = 'that of a contour in um, as "0.10 um"'
            raise InputError(contour.source, "edge error", expected, "nothing", "or give the contour in px")
    else:
        if pixel_size is None or pixel_size.error == 0.0:
            raise InputError(contour.source, "pixel size", "one with an error for points in pixels", "nothing")
        unit = pixel_size
        if np.array_equal(outline, np.rint(outline)) and not contour.along_borders and points not in POINTS:
            expected = "whether these whole pixels are centres of pixels or borders between them"
            raise InputError(contour.source, "points", expected, repr(points), "say centres or borders")
        if points == "centres":
            outline = outline + _HALF_PIXEL * vertex_normals(outline)
    z, y = direction * outline[:, 0], outline[:, 1]
    centred = np.stack([z, y - 0.5 * (y.max() + y.min())], axis=1)
    error = EDGE_ERROR if edge_error is None else edge_error.value / unit.value
    return unit, centred, error


def _allowed(contour: ContourFile) -> float:
    """Return how far the edge may lie from what was traced, in the unit of a contour."""
    return float(max(_MOST_OFF * np.sqrt(abs(signed_area(contour.points)) / np.pi), float(contour.unit == "px")))


def _spike(contour: ContourFile) -> float:
    """Return how far a point, or a few next to each other, jut out from the others of a contour, zero if none does."""
    # the contour turns back on either side of a spike, which it does at no corner of a capsule
    outline, furthest = contour.points, 0.0
    for step in range(1, min(_WIDEST, len(outline) // _APART) + 1):
        off, chance = _off_neighbours(outline, step)
        chord = np.roll(outline, -step, axis=0) - np.roll(outline, step, axis=0)
        off = np.abs(off[:, 0] * chord[:, 1] - off[:, 1] * chord[:, 0]) / np.hypot(*chord.T)
        sides = (outline - np.roll(outline, step, axis=0)) @ np.array([1.0, 1.0j])
        turn = np.angle(np.roll(sides, -step) / sides)
        turn -= np.median(turn)
        others = np.array([np.roll(turn, step), np.roll(turn, -step)])
        net = np.abs(turn + others.sum(axis=0))
        alone = np.all(others * turn < 0.0, axis=0) & (np.abs(turn) > _CORNER) & (net < _CORNER)
        far = np.where(alone & (off > _OUTLIER * robust_spread(off / chance) * chance), off, 0.0)
        k = int(np.argmax(far))
        if far[k] > _allowed(contour):
            got = f"one that juts out by {far[k]:.3g} {contour.unit} at ({outline[k, 0]:.4g}, {outline[k, 1]:.4g})"
            raise InputError(contour.source, "points", "points along the edge of the capsule", got)
        furthest = max(furthest, float(far[k]))
    return furthest


def _missing(contour: ContourFile) -> float:
    """Return how far the edge may lie beyond the sides that are longer than the others, if it is an arc there."""
    # An arc that turns by an angle rises above its chord by an eighth of it times the chord. It makes the angle of the
    # chord with the stretches before and after it, a share of its length each, larger by that share.
    points = contour.points[:, 0] + 1j * contour.points[:, 1]
    arc = arc_length(contour.points)
    sides, closed, furthest = np.diff(arc), np.append(points, points[0]), 0.0
    usual = np.median(sides)
    for k in np.flatnonzero(sides > _LONG * usual).tolist():
        share = min(0.5, _LONG * usual / sides[k])
        around = np.array([arc[k] - share * sides[k], arc[k], arc[k + 1], arc[k + 1] + share * sides[k]])
        steps = np.diff(np.interp(around % arc[-1], arc, closed))
        height = float(sides[k] * np.abs(np.angle(steps[1:] / steps[:-1])).sum() / (8.0 * (1.0 + share)))
        if height > _allowed(contour):
            got = " and ".join(f"({end.real:.4g}, {end.imag:.4g})" for end in closed[k : k + 2])
            expected = "points all around the capsule, once"
            raise InputError(contour.source, "points", expected, f"none between {got} {contour.unit}")
        furthest = max(furthest, height)
    return furthest


def _scatter(outline: Floats) -> float:
    """Return the standard deviation of the points along the normal, of which corners are few."""
    off, chance = _off_neighbours(outline)
    return robust_spread(np.sum(off * vertex_normals(outline), axis=1) / chance)


def _off_neighbours(outline: Floats, step: int = 1) -> tuple[Floats, Floats]:
    """Return how far each point lies from a cubic through two neighbours either side : (n, 2) array."""
    # and its standard deviation along the normal over that of one point (n,); cubics of the arc length: points at
    # unequal distances do not scatter
    steps = np.array([np.roll(outline, -k * step, axis=0) - outline for k in (-2, -1, 1, 2)])
    apart = np.hypot(*np.moveaxis(steps, -1, 0))
    before, after = np.roll(apart[2], step), np.roll(apart[2], -step)
    places = np.array([-apart[1] - np.roll(before, step), -apart[1], apart[2], apart[2] + after])
    others = [[places[j] for j in range(4) if j != k] for k in range(4)]
    # weights of Lagrange, at the point itself
    weights = np.array([np.prod([p / (p - places[k]) for p in others[k]], axis=0) for k in range(4)])
    off = -np.einsum("kn,knd->nd", weights, steps)
    return off, np.sqrt(1.0 + np.sum(weights**2, axis=0))


def _smooth(outline: Floats) -> Floats:
    """Return dense points of a smooth closed curve through those of a sparse contour; its long sides stay straight."""
    # a cubic would rise above a long run of pixels, at whose ends the contour turns by half a right angle
    if len(outline) >= _SPARSE:
        return outline
    place, closed = arc_length(outline), np.concatenate([outline, outline[:1]])
    parts = np.diff(place) / np.median(np.diff(place))
    parts = np.where(parts > _LONG, np.ceil(parts), 1.0)
    at = np.interp(np.arange(parts.sum() + 1.0), np.append(0.0, np.cumsum(parts)), place)
    closed, place = np.stack([np.interp(at, place, closed[:, axis]) for axis in (0, 1)], axis=1), at
    spline = CubicSpline(place, closed, bc_type="periodic")
    return np.asarray(spline(np.linspace(0.0, place[-1], 2 * _SPARSE, endpoint=False)))
