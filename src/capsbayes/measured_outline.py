"""Measured outline of a capsule: points along its edge, with the covariance of their errors."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.csv_file import read_numbers, text_of_numbers
from capsbayes.files.input_file import InputFile, checked_table, file_name, number
from capsbayes.files.output_file import write_file
from capsbayes.profile import arc_length, check_simple, signed_area

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

    Parameters
    ----------
    along, across : float
        Shift along and across the flow, over l.
    tilt : float
        Of the flow direction on the picture [rad].
    offset : float
        Of all edges along their normals, over l: a halo or a threshold puts them too far out.
    rear : float
        Of the rear as it is seen, along the flow, over l: in a picture whose edge is wider there than at the nose.
    pixel_aspect, distortion, taper : float
        Of the numbers of a `Camera`, which is taken to be without faults otherwise.
    middle : float
        Not a deviation: where the middle of the capsule is along the flow, from the middle of the picture, over l.
    walls : float
        Nor this: mean square distance from there of the walls at which l was read, over l^2.
    """

    along: float = 1.0
    across: float = 1.0
    tilt: float = 0.05
    offset: float = 0.0
    rear: float = 0.0
    pixel_aspect: float = 0.0
    distortion: float = 0.0
    taper: float = 0.0
    middle: float = 0.0
    walls: float = 1.0

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
        """Read the outline that the table ``[outline]`` of a measurement's file names.

        Parameters
        ----------
        file : InputFile
            With the keys ``file``, a CSV file in its folder with the columns ``z_over_l`` and ``y_over_l``; ``noise``,
            the standard deviation of the normal errors over l; ``correlation``, their length along the arc over l; and
            optionally ``white``, the share of their variance that is independent from point to point, ``pose``, a
            table of some of the numbers of a `Pose`, as ``{ offset = 0.01 }``, and ``view``, one of `VIEWS`.

        Returns
        -------
        MeasuredOutline

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        table = file.table(
            "outline",
            required={"file": file_name("outline.csv"), "noise": number(0.0, MOST), "correlation": number(0.0, MOST)},
            optional={"white": number(0.0, 1.0), "pose": _pose, "view": check_view},
        )
        noise = OutlineNoise(table["noise"], table["correlation"], table.get("white", 0.0))
        points = read_numbers(table["file"], _COLUMNS, "file of points")
        return cls(points, noise, table.get("pose", Pose()), table.get("view", MID_PLANE))

    def write(self, path: Path) -> list[str]:
        """Write the points to a CSV file.

        Parameters
        ----------
        path : Path

        Returns
        -------
        list of str
            Lines of the table ``[outline]`` with which `read` finds them, for a file of the same folder.
        """
        write_file(path, text_of_numbers(_COLUMNS, self.points, "%.9g"))
        noise, pose = self.noise, asdict(self.pose)
        posed = [f"pose = {{ {', '.join(f'{name} = {float(value)!r}' for name, value in pose.items())} }}"]
        return [
            "[outline]",
            f"file = {json.dumps(path.name)}",
            f"noise = {float(noise.scale)!r}",
            f"correlation = {float(noise.correlation_length)!r}",
            f"white = {float(noise.white)!r}",
            *(posed if self.pose != Pose() else []),
            *([f"view = {json.dumps(self.view)}"] if self.view != MID_PLANE else []),
        ]

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
        """Return the errors of the edges that all capsules of one microscope share.

        These are a displacement by `Pose.offset` all around, a displacement along arcs that is 1.5 times as large, and
        the geometry of the camera.

        Parameters
        ----------
        points, normal : (m, 2) array
            Vertices of an outline [l], and its outward unit normals.

        Returns
        -------
        (k, m) array [l]
            Displacements along the normals, each one standard deviation of one error.
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
        object.__setattr__(self, "view", check_view(self.view, "measurement", "outline.view"))
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
        object.__setattr__(self, "points", points)


def check_placed(outline: MeasuredOutline, axial_extent: float, where: str) -> None:
    """Refuse an outline that crosses itself, is not over l, or whose flow is not towards larger z in the first column.

    A capsule is blunter behind than ahead: the centre of the convex hull of all shapes of the databases is behind the
    middle of their length, by 0.003 to 0.066 of it.

    Parameters
    ----------
    outline : MeasuredOutline
    axial_extent : float [l]
        L_z as measured.
    where : str

    Raises
    ------
    InputError
    """
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
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        raise InputError(where, "outline", "points around an area", "points on a line") from None
    following = np.roll(hull, -1, axis=0)
    twice = hull[:, 0] * following[:, 1] - following[:, 0] * hull[:, 1]
    centre = np.sum((hull + following) * twice[:, None], axis=0) / (3.0 * twice.sum())
    low, high = hull.min(axis=0), hull.max(axis=0)
    return np.asarray((centre - 0.5 * (low + high)) / (high - low))


def check_view(view: object, where: str, key: str) -> str:
    """Return the name of a view, "mid-plane" for the "section" of older files; refuse another word."""
    view = MID_PLANE if isinstance(view, str) and view == "section" else view
    if not isinstance(view, str) or view not in VIEWS:
        raise InputError(where, key, " or ".join(f'"{known}"' for known in VIEWS), repr(view))
    return str(view)


def _pose(table: object, where: str, key: str) -> Pose:
    readers = {entry.name: number(0.0, MOST) for entry in fields(Pose)} | {"middle": number()}
    return Pose(**checked_table(table, where, key, optional=readers))
