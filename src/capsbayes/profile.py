"""Closed outline of a capsule, by arc length from the nose, and the lengths read from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError

_MOST_SIDES = 1000  # of an outline, compared with each other
_NEIGHBOURS = 4  # sides of it that noise may make cross
_NARROWEST = 0.05  # of the way between two points along it: their distance, which is 0.098 in the narrowest hollow
_LOOP = 20  # part of its points that go round a loop
_AXIS_TOLERANCE = 1e-6  # of the axial extent: how far from y = 0 the nose may lie (single precision rounds it)


@dataclass(frozen=True, eq=False)
class Profile:
    """Closed polygon in the plane of the flow direction z and one transverse direction y.

    Build it from points already in order, or from any closed outline with
    `from_outline`, or from one half of a symmetric one with `from_half`.

    Parameters
    ----------
    points : (p, 2) array
        Vertices, columns (z, y), in any one unit of length; ordered by arc length from the nose (the point of the axis
        y = 0 that is furthest along z), first through y > 0; the first vertex is not repeated.

    Raises
    ------
    InputError
        If the points are not such an outline.

    Examples
    --------
    >>> angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    >>> circle = Profile(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    >>> round(circle.axial_extent, 4), round(circle.parachute_depth, 4), round(circle.stretch_ratio(1.0), 4)
    (2.0, 0.0, 1.0)
    """

    points: Floats

    def __post_init__(self) -> None:
        points = _checked(self.points)
        extent = np.ptp(points[:, 0])
        if abs(points[0, 1]) > _AXIS_TOLERANCE * extent:
            raise _bad("a first point on the axis y = 0", f"y = {points[0, 1]:g}", "use Profile.from_outline")
        if signed_area(points) <= 0.0:
            raise _bad("the side y > 0 first", "the side y < 0 first", "use Profile.from_outline")
        if np.max(_axis_crossings(points), initial=-np.inf) > points[0, 0] + _AXIS_TOLERANCE * extent:
            raise _bad("the nose as first point", "another point of the axis", "use Profile.from_outline")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    @classmethod
    def from_outline(cls, points: ArrayLike) -> Profile:
        """Order any closed outline (p, 2), columns (z, y), as a contour of a picture gives it: any start, any sense.

        The last vertex may repeat the first. The nose is inserted where the outline crosses the axis between two
        vertices.
        """
        outline = _checked(points)
        if np.array_equal(outline[0], outline[-1]):
            outline = outline[:-1]
        if signed_area(outline) < 0.0:
            outline = outline[::-1]
        crossings = _axis_crossings(outline)
        if crossings.size < 2:
            raise _bad("an outline around the axis y = 0", f"{crossings.size} crossings of it", "shift it along y")
        nose = np.nanargmax(_crossing_of_each_edge(outline))
        start = np.array([[crossings.max(), 0.0]])
        rest = np.roll(outline, -(int(nose) + 1), axis=0)
        keep = np.any(np.abs(rest - start) > 1e-12 * np.ptp(outline[:, 0]), axis=1)
        return cls(np.concatenate([start, rest[keep]]))

    @classmethod
    def from_half(cls, half: ArrayLike) -> Profile:
        """Mirror one half of a symmetric outline, as a simulation of a symmetry wedge gives it, to 2 h - 2 vertices.

        Vertices (h, 2), columns (z, y), go from the nose to the rear point of the axis through y > 0; both have y = 0.
        """
        upper = _checked(half, minimum=3).copy()
        extent = np.ptp(upper[:, 0])
        ends = upper[[0, -1], 1]
        if np.max(np.abs(ends)) > _AXIS_TOLERANCE * extent:
            raise _bad("a half that starts and ends on the axis y = 0", f"y = {ends[0]:g} and {ends[1]:g}")
        upper[[0, -1], 1] = 0.0
        return cls(np.concatenate([upper, upper[-2:0:-1] * np.array([1.0, -1.0])]))

    @property
    def axial_extent(self) -> float:
        """Maximum extension along the flow L_z."""
        return float(np.ptp(self.points[:, 0]))

    @property
    def axial_length(self) -> float:
        """Distance between the two points of the axis L_a."""
        return float(np.ptp(_axis_crossings(self.points)))

    @property
    def parachute_depth(self) -> float:
        """Depth of the concave rear L_p = L_z - L_a, zero for a convex rear."""
        return self.axial_extent - self.axial_length

    @property
    def perimeter(self) -> float:
        """Length of the outline P."""
        return float(edge_lengths(self.points).sum())

    @property
    def area(self) -> float:
        """Area within the outline."""
        return signed_area(self.points)

    def stretch_ratio(self, radius: float) -> float:
        """Return the perimeter over that of the sphere at rest of a radius in the same unit, Lambda = P / (2 pi a)."""
        return self.perimeter / (2.0 * np.pi * radius)

    def resampled(self, count: int) -> Profile:
        """Return the outline with `count` points, at least 4, at equal arc length, the first at the nose.

        When `count` is even, a symmetric outline keeps its rear point.
        """
        return Profile(equally_spaced(self.points, count))

    def scaled(self, factor: float) -> Profile:
        """Return the outline with every length multiplied by a positive factor: a change of unit."""
        return Profile(self.points * factor)

    def translated(self, dz: float) -> Profile:
        """Return the outline moved by `dz` along the flow."""
        return Profile(self.points + np.array([dz, 0.0]))

    def mirrored(self) -> Profile:
        """Return the outline seen from the other side, y -> -y."""
        swapped = self.points * np.array([1.0, -1.0])
        return Profile(np.concatenate([swapped[:1], swapped[:0:-1]]))

    def hausdorff(self, other: Profile) -> float:
        """Return the Hausdorff distance to another outline of the same unit, neither moved.

        It is the largest distance from a vertex of either outline to the nearest point, vertex or not, of the other.
        """
        return max(_furthest(self.points, other.points), _furthest(other.points, self.points))


def check_simple(points: Floats, where: str) -> None:
    """Refuse an outline (p, 2) that crosses or touches itself, goes round twice, or whose points are not in order."""
    # Sides that are close along it may cross, as noise makes them do. Of many points, some are omitted.
    starts = points[:: -(-len(points) // _MOST_SIDES)]
    sides, apart = np.roll(starts, -1, axis=0) - starts, starts[None] - starts[:, None]
    on_left = sides[:, None, 0] * apart[:, :, 1] >= sides[:, None, 1] * apart[:, :, 0]
    opposite = on_left != np.roll(on_left, -1, axis=1)
    numbers, (arc, whole) = np.arange(len(starts)), np.split(arc_length(starts), [-1])
    steps, way = (np.abs(np.subtract.outer(along, along)) for along in (numbers, arc))
    steps = np.minimum(steps, len(starts) - steps)
    narrow = np.hypot(apart[..., 0], apart[..., 1]) < _NARROWEST * np.minimum(way, whole - way)
    for wrong, least, got in (
        (opposite & opposite.T, _NEIGHBOURS, "one that crosses itself, or points that are not in order"),
        (narrow, max(_NEIGHBOURS, len(starts) // _LOOP), "one that touches itself, or a second loop"),
    ):
        if (wrong & (steps > least)).any():
            raise InputError(where, "points", "one line around the capsule that does not cross itself", got)


def vertex_normals(points: Floats) -> Floats:
    """Return the outward unit normals (..., p, 2) at the vertices of closed outlines like a `Profile`'s."""
    around = np.concatenate([points[..., -1:, :], points, points[..., :1, :]], axis=-2)
    chord = around[..., 2:, :] - around[..., :-2, :]
    normals = np.stack([chord[..., 1], -chord[..., 0]], axis=-1)
    return np.asarray(normals / np.hypot(chord[..., 0], chord[..., 1])[..., None])


def _bad(expected: str, got: str, advice: str = "") -> InputError:
    return InputError("profile", "points", expected, got, advice)


def _checked(points: ArrayLike, minimum: int = 4) -> Floats:
    array = np.array(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < minimum:
        raise _bad(f"an array (p, 2) with p >= {minimum}", f"shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise _bad("finite coordinates", f"{int(np.sum(~np.isfinite(array)))} NaN or infinite ones")
    return array


def signed_area(points: Floats) -> float:
    """Return the area within a closed outline (p, 2) with columns (z, y), positive in the sense of a `Profile`."""
    after = following(points)
    return float(0.5 * np.sum(points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]))


def following(points: Floats) -> Floats:
    """Return the vertex that follows each of a closed outline (p, 2) : (p, 2) array."""
    return np.concatenate([points[1:], points[:1]])


def edge_lengths(points: Floats) -> Floats:
    """Return the length of each edge of a closed outline (p, 2), from its vertex to the next : (p,) array."""
    return np.asarray(np.hypot(*(following(points) - points).T))


def arc_length(points: Floats) -> Floats:
    """Return the arc length of a closed outline (p, 2) at each vertex, and that of the whole : (p + 1,) array."""
    return np.concatenate([[0.0], np.cumsum(edge_lengths(points))])


def arc_share(outline: Floats) -> Floats:
    """Return the share of the perimeter of an outline (p, 2) from its first vertex to each : (p,) array [%]."""
    arc = arc_length(outline)
    return np.asarray(100.0 * arc[:-1] / arc[-1])


def equally_spaced(points: Floats, count: int) -> Floats:
    """Return points at equal distances along a closed outline (p, 2), from its first vertex : (count, 2) array."""
    arc, closed = arc_length(points), np.concatenate([points, points[:1]])
    at = arc[-1] * np.arange(count) / count
    return np.stack([np.interp(at, arc, closed[:, axis]) for axis in (0, 1)], axis=1)


def with_extent(outline: Floats, axial_extent: float) -> Floats:
    """Give an outline (p, 2) of points at equal distances, which cut the rear rim, its known extent L_z."""
    # On either side the point furthest back moves back onto the plane of the rim; none lies behind it. Which point that
    # is changes from shape to shape: for outlines to be drawn, not for those to be fitted.
    mended, half = np.array(outline, dtype=np.float64), len(outline) // 2
    back = mended[0, 0] - axial_extent
    mended[:, 0] = np.maximum(mended[:, 0], back)
    for first, last in ((1, half + 1), (half, len(outline))):
        mended[first + np.argmin(outline[first:last, 0]), 0] = back
    return mended


def _crossing_of_each_edge(points: Floats) -> Floats:
    """Return z where each edge meets the axis y = 0, NaN if it does not : (p,) array."""
    # A vertex on the axis belongs to the side y > 0, so that it is met once.
    z, y = points.T
    z_next, y_next = np.roll(z, -1), np.roll(y, -1)
    crosses = (y >= 0.0) != (y_next >= 0.0)
    rise = np.where(crosses, y_next - y, 1.0)
    return np.where(crosses, z - y * (z_next - z) / rise, np.nan)


def _axis_crossings(points: Floats) -> Floats:
    crossings = _crossing_of_each_edge(points)
    return crossings[np.isfinite(crossings)]


def _furthest(points: Floats, outline: Floats) -> float:
    """Return the largest distance from a set of points to a closed polygon."""
    import shapely  # slow to import

    return float(shapely.distance(shapely.points(points), shapely.linearrings(outline)).max())
