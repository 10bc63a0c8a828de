"""What was measured of one capsule: lengths, outline, velocity, with their errors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
from scipy.special import chdtri

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.csv_file import read_numbers, text_of_numbers
from capsbayes.files.input_file import InputFile, Reader, checked_table, file_name, number, quantity, unread
from capsbayes.files.output_file import together, write_file
from capsbayes.footing import on_mirror
from capsbayes.parameters import STATED
from capsbayes.profile import arc_length, check_simple, signed_area
from capsbayes.quantity import Given, Quantity, settle, uncertain
from capsbayes.readable import Readable
from capsbayes.status import Status

# Measured outline of a capsule: points along its edge, with the covariance of their errors

MID_PLANE = "mid-plane"
"""View of an outline in the plane x = 0."""

SILHOUETTE = "silhouette"
"""View of an outline as a photograph shows it: the farthest edge of the capsule, which hides a concave rear."""

VIEWS = (MID_PLANE, SILHOUETTE)

FEWEST_POINTS = 16
MOST = 1000.0
"""Half widths, above which no error of an outline and no length along it lies."""

_OFF_MIDDLE = 0.015  # of the length, by which the centre of the convex hull is ahead of the middle in no capsule
_OFF_AXIS = 0.02  # of the breadth, by which it is beside the middle in no capsule that is usable
_LONGER = 1.5  # than L_z, or shorter, is no outline over the same l
_COLUMNS = ("z_over_l", "y_over_l")
_ALONG_ARCS = 1.5  # of the offset: what all edges share along arcs, as at corners where the blur is not Gaussian
_OF_MICROSCOPE = ("offset", "rear", "pixel_aspect", "distortion", "taper")


@dataclass(frozen=True)
class OutlineNoise:
    """Errors of the points of an outline along their normals: Gaussian, correlated as exp(-distance / length).

    Parameters
    ----------
    scale : float [l]
        Standard deviation.
    correlation_length : float [l]
        Correlation length along the arc; zero for independent errors.
    white : float [-]
        Share of the variance that is independent from point to point.
    """

    scale: float
    correlation_length: float
    white: float = 0.0

    def __post_init__(self) -> None:
        for name, good in (
            ("scale", 0.0 < self.scale <= MOST),
            ("correlation_length", 0.0 <= self.correlation_length <= MOST),
            ("white", 0.0 <= self.white <= 1.0),
        ):
            if not good:
                most = 1.0 if name == "white" else MOST
                expected = f"a {'positive ' if name == 'scale' else ''}number up to {most:g}"
                raise InputError("OutlineNoise", name, expected, f"{getattr(self, name):g}")

    def covariance(self, points: Floats) -> Floats:
        """Return the covariance (m, m) of the errors at the vertices (m, 2) of a closed outline."""
        arc = arc_length(points)
        apart = np.abs(arc[:-1, None] - arc[:-1])
        apart = np.minimum(apart, arc[-1] - apart)
        same = np.eye(len(points))
        smooth = np.exp(-apart / self.correlation_length) if self.correlation_length else same
        covariance: Floats = self.scale**2 * ((1.0 - self.white) * smooth + self.white * same)
        return covariance

    def larger(self, further: float) -> OutlineNoise:
        """Return the noise with a further standard deviation [l] that is correlated along the arc."""
        scale = float(np.hypot(self.scale, further))
        return replace(self, scale=scale, white=self.white * (self.scale / scale) ** 2)

    def drawn(self, rng: np.random.Generator, points: Floats, count: int) -> Floats:
        """Draw errors for the vertices (m, 2) of a closed outline : (count, m) array."""
        return np.asarray(rng.standard_normal((count, len(points))) @ self.factor(points).T)

    def factor(self, points: Floats) -> Floats:
        """Return the Cholesky factor (m, m) of the covariance of the errors at the vertices (m, 2)."""
        least = 1e-12 * self.scale**2 * np.eye(len(points))
        return np.asarray(scipy.linalg.cholesky(self.covariance(points) + least, lower=True))


@dataclass(frozen=True)
class Pose:
    """Standard deviations of the position, the tilt and the offset of an outline, its rear, and the camera's geometry.

    Those of a `Camera` are of its numbers; it is taken to be without faults otherwise. The last two are no deviations.
    """

    along: float = 1.0  # shift along the flow, over l
    across: float = 1.0  # and across it
    tilt: float = 0.05  # of the flow direction on the picture [rad]
    offset: float = 0.0  # of all edges along their normals, over l: a halo or a threshold puts them too far out
    rear: float = 0.0  # as it is seen, along the flow, over l: where the edge in a picture is wider than at the nose
    pixel_aspect: float = 0.0
    distortion: float = 0.0
    taper: float = 0.0
    middle: float = 0.0  # where that of the capsule is along the flow, from the middle of the picture, over l
    walls: float = 1.0  # mean square distance from there of the walls at which l was read, over l^2

    def directions(self, points: Floats, normal: Floats) -> Floats:
        """Return the change of the normal distances by a standard deviation of each but `rear` : (m, 4 to 7) array."""
        turned = points[:, 0] * normal[:, 1] - points[:, 1] * normal[:, 0]
        each = [self.along * normal[:, 0], self.across * normal[:, 1], self.tilt * turned]
        each.append(np.full(len(points), self.offset))
        place = points - 0.5 * (points.max(axis=0) + points.min(axis=0)) + [self.middle, 0.0]
        radial = np.sum(place * normal, axis=1)
        of_camera = (
            (self.pixel_aspect, place[:, 0] * normal[:, 0]),
            (self.distortion, (np.sum(place**2, axis=1) - self.walls) * radial),
            (self.taper, place[:, 0] * radial),
        )
        return np.stack([*each, *(sd * change for sd, change in of_camera if sd > 0.0)], axis=1)


MOST_ASKEW = 0.02
"""Root mean square of the odd part of an outline [l], up to which capsules off the axis were tried."""

_CHANCE = 1e-3  # that noise alone has an odd part as large: a larger one is none
_OF_POSE = 2.0  # odd degrees of freedom that a shift and a turn take away


def askew_size(points: Floats, noise: OutlineNoise, odd: Floats | None = None) -> float:
    """Return the root mean square [l] of the odd part of an outline (m, 2) without noise; 0 where that explains it."""
    odd = on_mirror(points)[0] if odd is None else odd
    # The noise of the odd part is half of two independent errors, its degrees of freedom are half of those of the noise
    # after Satterthwaite.
    square, of_noise = float(np.nanmean(odd**2)), 0.5 * noise.scale**2
    if square <= of_noise:
        return 0.0
    covariance = noise.covariance(points)
    freedom = max(0.5 * np.trace(covariance) ** 2 / np.sum(covariance**2) - _OF_POSE, 1.0)
    most = float(chdtri(freedom, _CHANCE)) / freedom * of_noise
    return float(np.sqrt(square - of_noise)) if square > most else 0.0


@dataclass(frozen=True, eq=False)
class MeasuredOutline:
    """Edge of a capsule, in its mid-plane or seen from the side.

    Parameters
    ----------
    points : (m, 2) array [l]
        Consecutive vertices of a closed outline, columns (z, y), at least 16, in either sense of rotation and at
        any position and tilt.
    noise : OutlineNoise
    pose : Pose
        Uncertainty of its position, tilt and offset.
    view : str
        ``"mid-plane"`` in the plane x = 0, ``"silhouette"`` as seen from the side.

    Raises
    ------
    InputError
        If the points are not such an outline.
    """

    points: Floats
    noise: OutlineNoise
    pose: Pose = field(default_factory=Pose)
    view: str = MID_PLANE

    @classmethod
    def read(cls, file: InputFile) -> MeasuredOutline:
        """Read the outline that the table ``[outline]`` of a measurement's file names."""
        table = file.table(
            "outline",
            required={"file": file_name("outline.csv"), "noise": number(0.0, MOST), "correlation": number(0.0, MOST)},
            optional={"white": number(0.0, 1.0), "pose": _pose, "view": check_view},
        )
        noise = OutlineNoise(table["noise"], table["correlation"], table.get("white", 0.0))
        points = read_numbers(table["file"], _COLUMNS, "file of points")
        return cls(points, noise, table.get("pose", Pose()), table.get("view", MID_PLANE))

    def write(self, path: Path) -> list[str]:
        """Write the points to a CSV file; return the table ``[outline]`` with which `read` finds them, line by line."""
        write_file(path, text_of_numbers(_COLUMNS, self.points, "%.9g"))
        noise, pose = self.noise, asdict(self.pose)
        numbers = {"noise": noise.scale, "correlation": noise.correlation_length, "white": noise.white}
        lines = ["[outline]", f"file = {json.dumps(path.name)}"]
        lines += [f"{name} = {float(value)!r}" for name, value in numbers.items()]
        if self.pose != Pose():
            lines.append(f"pose = {{ {', '.join(f'{name} = {float(value)!r}' for name, value in pose.items())} }}")
        if self.view != MID_PLANE:
            lines.append(f"view = {json.dumps(self.view)}")
        return lines

    def noisier(self, further: float) -> MeasuredOutline:
        """Return the outline with a further standard deviation [l] of the displacements along its arcs."""
        return replace(self, noise=self.noise.larger(further))

    def shared_by(self, count: int) -> MeasuredOutline:
        """Return the outline with wider errors, for one of `count` capsules that share errors of the microscope.

        The variances of the displacements that `shared` returns, and of the rear, are multiplied by the number of
        capsules. If the capsules are then treated as independent, their mean has the variance of a single one.
        """
        pose = self.pose
        noise = self.noise.larger(float(np.sqrt(count - 1.0)) * self._along_arcs)
        wider = {name: float(np.sqrt(count)) * getattr(pose, name) for name in _OF_MICROSCOPE}
        return replace(self, noise=noise, pose=replace(pose, **wider))

    def shared(self, points: Floats, normal: Floats) -> Floats:
        """Return the errors of the edges that all capsules of one microscope share, at vertices with normals (m, 2).

        These are a displacement by `Pose.offset` all around, a displacement along arcs that is 1.5 times as large, and
        the geometry of the camera: (k, m) displacements along the normals [l], each one standard deviation.
        """
        of_microscope = self.pose.directions(points, normal)[:, 3:]  # place and tilt are each capsule's own
        if not self._along_arcs:
            return np.asarray(of_microscope.T)
        arcs = replace(self.noise, scale=self._along_arcs, white=0.0).factor(points)
        return np.concatenate([of_microscope, arcs], axis=1).T

    @property
    def _along_arcs(self) -> float:
        """Standard deviation of what all capsules share along arcs, over l."""
        return _ALONG_ARCS * self.pose.offset if self.noise.correlation_length else 0.0

    def __post_init__(self) -> None:
        view = check_view(self.view, "measurement", "outline.view")
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < FEWEST_POINTS:
            expected = f"an array (m, 2) with m >= {FEWEST_POINTS}"
            raise InputError("measurement", "outline", expected, f"shape {points.shape}")
        if not np.isfinite(points).all():
            raise InputError("measurement", "outline", "finite coordinates", "NaN or infinite ones")
        if np.array_equal(points[0], points[-1]):
            points = points[:-1]
        if signed_area(points) < 0.0:
            points = points[::-1]
        points = np.ascontiguousarray(points)
        points.setflags(write=False)
        settle(self, points=points, view=view)


def check_placed(outline: MeasuredOutline, axial_extent: float, where: str) -> None:
    """Refuse an outline that crosses itself, is not over l, or does not flow towards larger z in the first column."""
    # A capsule is blunter behind than ahead: the centre of the convex hull of all shapes of the databases is behind the
    # middle of their length, by 0.003 to 0.066 of it.
    check_simple(outline.points, where)
    extent = float(np.ptp(outline.points[:, 0]))
    if not axial_extent / _LONGER < extent < axial_extent * _LONGER:
        expected = f"points over l, some {axial_extent:.3g} long along the flow as axial_extent says"
        raise InputError(
            where, "outline", expected, f"{extent:.3g}", "divide them by l; z, along the flow, comes first"
        )
    ahead, beside = _centre_off_middle(outline.points, where)
    if abs(beside) > max(_OFF_AXIS, 2.0 * abs(ahead)):
        expected, got = "z, along the flow, in the first column", "an outline with nose and rear along the second"
        raise InputError(where, "outline", expected, got, "exchange the columns")
    if ahead > _OFF_MIDDLE:
        expected, got = "the flow towards larger z, with the blunt rear behind", "an outline with its blunt side ahead"
        raise InputError(where, "outline", expected, got, "change the sign of z where the flow is to the left")


def _centre_off_middle(points: Floats, where: str) -> Floats:
    """Return the centre of area of the convex hull from the middle of the extents, over these : (2,) array."""
    from shapely import MultiPoint  # slow to import

    hull = MultiPoint(points).convex_hull
    if not hull.area > 0.0:
        raise InputError(where, "outline", "points around an area", "points on a line")
    low, high = points.min(axis=0), points.max(axis=0)
    return np.asarray((np.array(hull.centroid.coords[0]) - 0.5 * (low + high)) / (high - low))


def check_view(view: object, where: str, key: str) -> str:
    """Return the name of a view, "mid-plane" for the "section" of older files; refuse another word."""
    view = MID_PLANE if isinstance(view, str) and view == "section" else view
    if not isinstance(view, str) or view not in VIEWS:
        raise InputError(where, key, " or ".join(f'"{known}"' for known in VIEWS), repr(view))
    return str(view)


def _pose(table: object, where: str, key: str) -> Pose:
    readers = {entry.name: number(0.0, MOST) for entry in fields(Pose)} | {"middle": number()}
    return Pose(**checked_table(table, where, key, optional=readers))


# Measurement of one capsule: its lengths and its velocity, each with its standard error

_FLOW_RATE = STATED["flow_rate"].example

CONDITIONS = ("half_width", "viscosity")
"""Conditions of an experiment that may differ from capsule to capsule of a set."""


@dataclass(frozen=True, eq=False, repr=False)
class Measurement(Readable):
    """Lengths and velocity of one capsule at steady state.

    The error of the velocity is taken as independent of those of the lengths. A length and the velocity are given with
    their errors, in any form that `Quantity.of` reads, or with the error apart, a number in SI or a quantity of the
    same unit.

    Parameters
    ----------
    axial_extent, axial_extent_error : float
        Maximum extension along the flow L_z and its standard error, over l or in metres.
    capsule_velocity, capsule_velocity_error : float [m/s]
        Velocity of the capsule v_o and its standard error; both are missing, None and NaN, where it was not measured
        because the flow rate is known or the experiment states the viscous tension.
    axial_length, axial_length_error : float, optional
        Length on the axis L_a and its standard error, in the unit of L_z; missing where the rear is hidden.
    length_correlation : float
        Correlation of the errors of the two lengths, between -1 and 1.
    over_half_width : bool
        True for lengths over l (measured against the walls on the same picture), False for lengths in metres; lengths
        given with a unit decide it themselves.
    outline : MeasuredOutline, optional
        The whole edge, over l. It replaces the lengths in the likelihood; they then only give initial values. A
        silhouette does not show L_a, which is used in addition.
    source : str
        File the measurement was read from, empty if none.
    sha256 : str
        Fingerprint of that file.
    experiment_file : Path, optional
        The experiment the file names.
    status : Status
        How the measurement ended; the numbers are NaN unless it is ``DONE``.
    axial_length_bound : float, optional
        Upper limit of a missing L_a: the length of the silhouette with two standard errors.
    flow_rate, flow_rate_error : float, optional
        Flow rate in the channel [m^3/s] and its standard error, zero if it is taken as known: a source of the mean
        velocity U, which is the flow rate over the area of the cross-section, next to the velocity or in its place.
    conditions : mapping of str to float
        ``half_width`` and ``viscosity`` of this capsule of a set, in SI, if they differ from those of the experiment. A
        measurement file states them by the experiment that it names.
    walls : str
        How the walls, and thus l in pixels, were stated by hand; empty if they were found in the picture.
    doubt : str
        What is doubtful about the walls, the grey levels or the edge, in sentences; empty if nothing.

    Raises
    ------
    InputError
        On a value that is not positive, finite and plausible, or L_a > L_z.

    Examples
    --------
    >>> seen = Measurement(axial_extent=2.14, axial_extent_error=0.01, capsule_velocity=5e-3,
    ...                    capsule_velocity_error=5e-5, axial_length=1.81, axial_length_error=0.01)
    >>> seen.lengths, seen.covariance.shape
    (array([2.14, 1.81]), (2, 2))
    >>> Measurement(axial_extent="53.5 +/- 0.3 um", capsule_velocity="5.00 +/- 0.05 mm/s").over_half_width
    False
    >>> Measurement(axial_extent="2.14 +/- 0.01", capsule_velocity="5.00 +/- 0.05 mm/s")
    <Measurement: axial_extent 2.14 +/- 0.01 l; capsule_velocity 5 +/- 0.05 mm/s>
    """

    axial_extent: Given
    axial_extent_error: float = float("nan")
    capsule_velocity: Given = None
    capsule_velocity_error: float = float("nan")
    axial_length: Given | None = None
    axial_length_error: float | None = None
    length_correlation: float = 0.0
    over_half_width: bool = True
    outline: MeasuredOutline | None = None
    source: str = ""
    sha256: str = ""
    experiment_file: Path | None = None
    status: Status = Status.DONE
    axial_length_bound: float | None = None
    flow_rate: Given | None = None
    flow_rate_error: float | None = None
    conditions: Mapping[str, float] = field(default_factory=dict)
    walls: str = ""
    doubt: str = ""

    def __post_init__(self) -> None:
        where = self.source or "measurement"
        for key, kind in (("status", Status), ("outline", MeasuredOutline | None), ("conditions", Mapping)):
            if not isinstance(given := getattr(self, key), kind):
                raise InputError(where, key, getattr(kind, "__name__", str(kind)), repr(given)[:60])
        if not self.status.ok:
            return
        if (unit := self._split(where, "axial_extent", ("", "m"))) is not None:
            settle(self, over_half_width=not unit)
        self._split(where, "axial_length", ("",) if self.over_half_width else ("m",))
        self._split(where, "capsule_velocity", ("m/s",))
        for key in ("axial_extent", "capsule_velocity", "axial_length"):
            self._check_pair(where, key)
        if self.flow_rate is not None:
            self._split_flow_rate(where)
        self._check_lengths(where)
        for key in self.conditions:
            if key not in CONDITIONS:
                raise InputError(where, "conditions", " or ".join(CONDITIONS), repr(key))
        read = {key: Quantity.of(value, key, where=where).value for key, value in self.conditions.items()}
        settle(self, conditions=read)
        if not (_is_number(self.length_correlation) and -1.0 < self.length_correlation < 1.0):
            raise InputError(where, "length_correlation", "a number between -1 and 1", repr(self.length_correlation))

    def _check_lengths(self, where: str) -> None:
        """Refuse a length on the axis, its bound or an outline that does not fit to the extent."""
        bound, extent = self.axial_length_bound, self.axial_extent
        if bound is not None and not (_is_number(bound) and np.isfinite(bound) and bound > 0.0):
            raise InputError(where, "axial_length_bound", "a positive finite number", repr(bound))
        if bound is not None and self.axial_length is not None:
            raise InputError(where, "axial_length_bound", "none next to axial_length", f"{bound:g}", "omit one of them")
        if self.axial_length is not None and self.axial_length > extent:
            raise InputError(where, "axial_length", f"at most the axial extent {extent:g}", f"{self.axial_length:g}")
        if self.outline is not None and not self.over_half_width:
            raise InputError(where, "outline", "lengths over l, as the outline is", "lengths in metres", "divide by l")

    def _split_flow_rate(self, where: str) -> None:
        """Split the flow rate into its value and its error, which may be zero."""
        rate = Quantity.of(self.flow_rate, "flow_rate", where=where)
        if rate.shape != "normal":
            raise InputError(where, "flow_rate", f'a standard error, as in "{_FLOW_RATE}"', str(self.flow_rate))
        error = rate.error or _apart(self.flow_rate_error, where, "flow_rate_error", ("m^3/s",)) or 0.0
        if not 0.0 <= error <= rate.value:
            raise InputError(where, "flow_rate_error", f"a number from 0 to {rate.value:g}", repr(error))
        settle(self, flow_rate=rate.value, flow_rate_error=error)

    def _split(self, where: str, key: str, units: tuple[str, ...]) -> str | None:
        """Split a quantity into its value and its error; return its unit, None if it is a number or missing."""
        given, error = getattr(self, key), getattr(self, f"{key}_error")
        if given is None or _is_number(given):
            bare = units if key == "capsule_velocity" else ("",) if self.over_half_width else ("m",)
            settle(self, **{f"{key}_error": _apart(error, where, f"{key}_error", bare)})
            return None
        apart = error is not None and not _is_number(error)  # a bare number beside a unit could be in either
        made = Quantity.of(given, key, where=where, units=units) if apart else _measured(*units)(given, where, key)
        stated = _apart(error, where, f"{key}_error", (made.unit,)) if apart else made.error
        if apart and made.error:
            raise InputError(where, f"{key}_error", "one error", f"{made}, and {error}")
        settle(self, **{key: made.value, f"{key}_error": stated})
        return made.unit

    def _check_pair(self, where: str, key: str) -> None:
        """Refuse a value or an error that is missing, NaN, infinite, not positive or not plausible."""
        value, error = getattr(self, key), getattr(self, f"{key}_error")
        if key == "axial_length" and value is None and error is None:
            return
        if key == "capsule_velocity" and value is None and np.isnan(error):
            return
        for name, given in ((key, value), (f"{key}_error", error)):
            if given is None or not (np.isfinite(given) and given > 0.0):
                raise InputError(where, name, "a positive finite number", repr(given))
        if error > value:
            raise InputError(where, f"{key}_error", f"at most the value {value:g}", f"{error:g}")
        if key == "capsule_velocity" or self.over_half_width:
            Quantity.of(float(value), key, where=where)

    @classmethod
    def refused(
        cls, status: Status, *, source: str = "", sha256: str = "", experiment_file: Path | None = None
    ) -> Measurement:
        """Return a measurement that failed: its status says why, its numbers are NaN."""
        nothing = (float("nan"),) * 4
        return cls(*nothing, status=status, source=source, sha256=sha256, experiment_file=experiment_file)

    @classmethod
    def read(cls, path: str | Path) -> Measurement:
        """Read a measurement from TOML with units and errors.

        Parameters
        ----------
        path : path
            File with a table ``[measurement]``: ``axial_extent``, ``capsule_velocity`` or ``flow_rate`` or both, unless
            the experiment states a viscous tension, and optionally ``axial_length`` and ``length_correlation``, or
            ``axial_length_bound``, ``walls`` and ``doubt``.
            It may name its experiment file (``experiment = "..."``, relative to itself) and state a ``[prior]``, which
            `capsbayes.infer.Prior.read` reads, a ``[membrane]``, which `capsbayes.infer.Membrane.read` reads, and an
            ``[outline]``, which `MeasuredOutline.read` reads.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        others = dict.fromkeys(("prior", "membrane", "outline"), unread)
        top = file.table(required=("measurement",), optional={"experiment": file_name("experiment.toml"), **others})
        table = file.table(
            "measurement",
            required={"axial_extent": _measured("", "m")},
            optional={
                "capsule_velocity": _measured("m/s"),
                "axial_length": unread,
                "length_correlation": unread,
                "axial_length_bound": unread,
                "flow_rate": quantity("flow_rate"),
                "walls": _text,
                "doubt": _text,
            },
        )
        if "length_correlation" in table and "axial_length" not in table:
            raise InputError(str(path), "measurement.length_correlation", "axial_length with it", "none")
        if "axial_length" in table:
            read = _measured(table["axial_extent"].unit)
            table["axial_length"] = read(table["axial_length"], str(path), "measurement.axial_length")
        measurement = cls(
            **table,
            outline=MeasuredOutline.read(file) if "outline" in top else None,
            source=str(path),
            sha256=file.sha256,
            experiment_file=top.get("experiment"),
        )
        measurement.check_outline(measurement.source)
        return measurement

    def check_outline(self, where: str) -> None:
        """Refuse an outline that is not over l, or whose flow is not along its first column, towards larger z."""
        if self.outline is not None:
            check_placed(self.outline, float(self.axial_extent), where)

    def write(self, path: str | Path) -> None:
        """Write a file that `read` reads.

        Parameters
        ----------
        path : path
            The experiment is named in it by its absolute path, or by its name alone if it lies in the same folder; an
            outline is written next to it, in a CSV file of the same name.

        Raises
        ------
        InputError
            If the measurement failed.
        """
        if not self.status.ok:
            raise InputError("measurement", "status", "a measurement that ended as it should", str(self.status))
        lines = ["", "[measurement]"]
        if self.experiment_file:
            file = self.experiment_file.resolve()
            bare = file.parent == Path(path).resolve().parent
            lines.insert(0, f"experiment = {json.dumps(file.name if bare else str(file))}")
        for name, measured in self._stated.items():
            lines.append(f'{name} = "{measured}"')
            if name == "axial_length":
                lines.append(f"length_correlation = {float(self.length_correlation)!r}")
            if name == "axial_extent" and self.axial_length_bound is not None:
                lines.append(f"axial_length_bound = {float(self.axial_length_bound)!r}")
        for name, text in {"walls": self.walls, "doubt": self.doubt}.items():
            if text:
                lines.append(f"{name} = {json.dumps(text)}")
        with together():
            if self.outline is not None:
                lines += ["", *self.outline.write(Path(path).with_suffix(".outline.csv"))]
            write_file(path, "\n".join(lines).lstrip() + "\n")

    def described(self) -> dict[str, str]:
        """Return what was measured in display units; the status alone where the measurement failed."""
        if not self.status.ok:
            texts = {"status": str(self.status)}
        else:
            texts = {name: measured.shown(name) for name, measured in self._stated.items()}
        if self.outline is not None:
            texts["outline"] = f"{len(self.outline.points)} points, {self.outline.view}"
        stated = {"walls": self.walls, "doubt": self.doubt, "source": self.source}
        return texts | {name: text for name, text in stated.items() if text}

    def flowing(self, rate: Quantity | None) -> Measurement:
        """Return the same with a flow rate [m^3/s], if there is one and the measurement did not fail."""
        if rate is None or not self.status.ok:
            return self
        return replace(self, flow_rate=rate.value, flow_rate_error=rate.error)

    @property
    def known_velocity(self) -> Quantity:
        """v_o with its standard error [m/s]; an error if it is missing."""
        if self.capsule_velocity is None:
            where, advice = self.source or "measurement", "this needs v_o; identify, batch and sensitivity sobol do not"
            if self.flow_rate is None:
                advice = "or state flow_rate, or viscous_tension = mu U in the experiment"
            raise InputError(where, "measurement.capsule_velocity", "a value with an error", "nothing", advice)
        return self._stated["capsule_velocity"]

    @property
    def _stated(self) -> dict[str, Quantity]:
        """What was measured, each number with its error, by name."""
        length = "" if self.over_half_width else "m"
        units = {"axial_extent": length, "axial_length": length, "capsule_velocity": "m/s", "flow_rate": "m^3/s"}
        pairs = {name: (getattr(self, name), getattr(self, f"{name}_error")) for name in units}
        return {
            name: Quantity(value, error or 0.0, units[name])
            for name, (value, error) in pairs.items()
            if value is not None
        }

    @property
    def lengths(self) -> Floats:
        """Measured lengths, L_z or (L_z, L_a) : (k,) array."""
        both = [self.axial_extent] if self.axial_length is None else [self.axial_extent, self.axial_length]
        return np.array(both)

    def named_experiment(self, advice: str) -> Path:
        """Return the file of its experiment; refuse a measurement that names none."""
        if self.experiment_file is None:
            raise InputError(self.source, "experiment", "the name of a file", "nothing", advice)
        return self.experiment_file

    @property
    def view(self) -> str:
        """View of the outline, the mid-plane if there is none."""
        return MID_PLANE if self.outline is None else self.outline.view

    @property
    def length_with_outline(self) -> tuple[float, float] | None:
        """L_a and its standard error where the outline is a silhouette, which does not show it, else None."""
        if self.outline is None or self.outline.view != SILHOUETTE:
            return None
        if self.axial_length is None or self.axial_length_error is None:
            return None
        return self.axial_length, self.axial_length_error

    @property
    def covariance(self) -> Floats:
        """Covariance of the errors of `lengths` : (k, k) array."""
        if self.axial_length_error is None:
            return np.array([[self.axial_extent_error**2]])
        cross = self.length_correlation * self.axial_extent_error * self.axial_length_error
        return np.array([[self.axial_extent_error**2, cross], [cross, self.axial_length_error**2]])


def _is_number(given: object) -> bool:
    return isinstance(given, (int, float, np.floating, np.integer)) and not isinstance(given, bool)


def _measured(*units: str) -> Reader:
    """Return a reader of measured quantities, which refuses one without an error: nothing would follow from it."""

    def read(given: Given, where: str, key: str) -> Quantity:
        return uncertain(given, key.removeprefix("measurement."), where=where, key=key, units=units)

    return read


def _apart(given: Given, where: str, key: str, units: tuple[str, ...]) -> Any:
    """Return a number that is stated apart from another in SI; what is a number or missing as it is."""
    if given is None or _is_number(given):
        return given
    return Quantity.of(given, where=where, key=key, units=units).value


def _text(value: object, where: str, key: str) -> str:
    if not isinstance(value, str):
        raise InputError(where, key, "a text", repr(value))
    return value
