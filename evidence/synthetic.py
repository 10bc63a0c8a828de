"""Synthetic pictures of a capsule between two walls, whose edges are known exactly.

The drawing is made on pixels three times finer than the camera's, from the distance of each to the outline, so that
edges are exact to a hundredth of a pixel. Positions are (x, y) in pixels, x to the right and y down, the centre of the
first pixel at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, uniform_filter1d
from scipy.spatial import KDTree

from capsbayes.arrays import Floats
from capsbayes.profile import Profile, arc_length, equally_spaced, signed_area, vertex_normals

_FINE = 3  # fine pixels along the side of one of the camera's
_EXACT = 1.5  # px from the outline within which the distance is not interpolated between the camera's pixels
_SPACING = 0.1  # px between the points that stand for an outline


@dataclass(frozen=True)
class Optics:
    """Light, capsule, lens and camera of a picture; lengths in pixels, the rest as fractions of the full light."""

    blur: float = 0.7  # [px]: standard deviation of the lens's blur
    motion: float = 0.0  # [px]: displacement of the capsule while the shutter is open, rounded to fine pixels
    band_depth: float = 0.6  # darkness at the outer edge
    band_width: float = 5.0  # depth inside at which it has fallen to 1/e
    interior: float = 0.25  # darkness of the capsule far from its edge
    halo: float = 0.0  # brightness added just outside the edge
    halo_width: float = 2.0  # distance at which it has fallen to 1/e
    rear_depth: float = 0.4  # darkness in the middle of the concave rear
    rear_width: float = 3.0  # distance at which it has fallen to 1/e
    wall_depth: float = 0.6  # darkness in the middle of a wall
    wall_width: float = 2.5  # distance at which it has fallen to 1/e
    outside: float = 0.93  # light beyond the walls
    vignetting: float = 0.0  # light lost in the corners of the picture
    unevenness: float = 0.0  # light gained from the left border to the right one, and from the upper one to the lower
    full_light: float = 200.0  # grey level of the full light
    electrons: float = 10_000.0  # electrons counted at the full light, whose shot noise is the square root
    background_frames: int = 16  # number of pictures of the empty channel that are averaged to the background


@dataclass(frozen=True, eq=False)
class Scene:
    """Geometry of a picture."""

    profile: ArrayLike  # (p, 2) [l]: outline in the plane of the axis, columns (z, y), z along the flow
    silhouette: ArrayLike  # (q, 2) [l]: outline seen from the side, columns (z, y)
    half_width: float  # [px]: half the width of the channel l
    shape: tuple[int, int] = (200, 200)  # rows and columns of the picture
    centre: tuple[float, float] | None = None  # [px]: of the capsule's length
    tilt: float = 0.0  # [rad]: angle of the channel to the rows, from x towards y
    flow: int = 1  # 1 if the capsule moves to the right, -1 if to the left

    @property
    def middle(self) -> Floats:
        """Place (x, y) of the middle of the capsule's length."""
        rows, columns = self.shape
        return np.array(((columns - 1) / 2.0, (rows - 1) / 2.0) if self.centre is None else self.centre)

    @property
    def across(self) -> Floats:
        """Unit vector (x, y) from the centre line to the lower wall."""
        return np.array([-np.sin(self.tilt), np.cos(self.tilt)])

    def placed(self, points: ArrayLike) -> Floats:
        """Return points (z, y) [l] as positions (x, y) [px] : (p, 2) arrays."""
        z, y = np.asarray(points, dtype=float).T
        ends = np.asarray(self.silhouette, dtype=float)[:, 0]
        along = self.flow * np.array([np.cos(self.tilt), np.sin(self.tilt)])
        local = (z - 0.5 * (ends.max() + ends.min()))[:, None] * along + y[:, None] * self.across
        return np.asarray(self.middle + self.half_width * local)


@dataclass(frozen=True, eq=False)
class Drawing:
    """A synthetic picture, that of the empty channel, and the true lengths."""

    picture: NDArray[np.uint8]  # (rows, columns)
    background: NDArray[np.uint8]  # without the capsule
    scene: Scene

    @property
    def half_width(self) -> float:
        """l [px]."""
        return self.scene.half_width

    @property
    def axial_extent(self) -> float:
        """L_z of the silhouette [px]."""
        return self.half_width * float(np.ptp(np.asarray(self.scene.silhouette)[:, 0]))

    @property
    def axial_length(self) -> float:
        """L_a of the profile [px]."""
        return self.half_width * Profile.from_outline(self.scene.profile).axial_length

    @property
    def outline(self) -> Floats:
        """Silhouette, columns (x, y) : (q, 2) array [px]."""
        return self.scene.placed(self.scene.silhouette)


def draw(scene: Scene, optics: Optics, *, seed: int) -> Drawing:
    """Draw a capsule in its channel, and the channel empty."""
    random = np.random.default_rng(seed)
    grid = _fine_grid(scene.shape)
    channel = _channel(grid, scene, optics)
    capsule = _capsule(grid, scene, optics)
    if optics.motion > 0.0:
        capsule = uniform_filter1d(capsule, 2 * round(0.5 * optics.motion * _FINE) + 1, axis=1, mode="nearest")
    light = _light(scene.shape, optics)
    seen = light * _on_camera(channel * capsule, optics.blur)
    empty = light * _on_camera(channel, optics.blur)
    return Drawing(_exposed(seen, 1, optics, random), _exposed(empty, optics.background_frames, optics, random), scene)


def _fine_grid(shape: tuple[int, int]) -> Floats:
    """Return the positions (x, y) of the centres of the fine pixels : (3 rows, 3 columns, 2) array [px]."""
    y, x = (np.arange(_FINE * count) / _FINE - (_FINE - 1) / (2 * _FINE) for count in shape)
    return np.stack(np.meshgrid(x, y), axis=-1)


def _channel(grid: Floats, scene: Scene, optics: Optics) -> Floats:
    apart = np.abs((grid - scene.middle) @ scene.across) - scene.half_width
    beyond = np.clip(_FINE * apart + 0.5, 0.0, 1.0)
    line = 1.0 - optics.wall_depth * np.exp(-((apart / optics.wall_width) ** 2))
    return np.asarray(line * (1.0 - (1.0 - optics.outside) * beyond))


def _capsule(grid: Floats, scene: Scene, optics: Optics) -> Floats:
    """Return the transmission of the capsule at each fine pixel."""
    outline = scene.placed(scene.silhouette)
    depth = _signed_distance(grid, outline, 2.6 * max(optics.band_width, optics.halo_width))
    inside = np.clip(_FINE * depth + 0.5, 0.0, 1.0)
    band = (optics.band_depth - optics.interior) * np.exp(-((np.maximum(depth, 0.0) / optics.band_width) ** 2))
    halo = optics.halo * np.exp(-((np.minimum(depth, 0.0) / optics.halo_width) ** 2))
    within = (1.0 - optics.interior - band) * _rear(grid, scene, optics)
    return np.asarray(inside * within + (1.0 - inside) * (1.0 + halo))


def _rear(grid: Floats, scene: Scene, optics: Optics) -> Floats:
    """Return the transmission of the membrane of the concave rear at each fine pixel."""
    rear = _concave_rear(np.asarray(scene.profile, dtype=float))
    if len(rear) < 3:
        return np.ones(grid.shape[:2])
    distance = _nearest(grid, _dense(scene.placed(rear)), 2.6 * optics.rear_width)
    return np.asarray(1.0 - optics.rear_depth * np.exp(-((distance / optics.rear_width) ** 2)))


def _concave_rear(profile: Floats) -> Floats:
    """Return the points of a profile between the rearmost points on either side of the axis."""
    rearmost = [
        np.flatnonzero(side)[np.argmin(profile[side, 0])] for side in (profile[:, 1] >= 0.0, profile[:, 1] < 0.0)
    ]
    start, stop = sorted(map(int, rearmost))
    return profile[start : stop + 1]


def _dense(points: Floats) -> Floats:
    """Return points along an open curve, from end to end."""
    length = arc_length(points)[:-1]
    at = np.linspace(0.0, length[-1], int(length[-1] / _SPACING))
    return np.stack([np.interp(at, length, points[:, axis]) for axis in (0, 1)], axis=1)


def _signed_distance(grid: Floats, outline: Floats, reach: float) -> Floats:
    """Return the distance to a closed outline, positive inside, up to `reach` : array of the shape of the grid."""
    dense = equally_spaced(outline, int(arc_length(outline)[-1] / _SPACING))
    inward = -np.sign(signed_area(dense)) * vertex_normals(dense)
    tree = KDTree(dense)

    def signed(points: Floats, reach: float) -> Floats:
        queried = tree.query(points, distance_upper_bound=reach)
        distance, nearest = np.asarray(queried[0]), np.asarray(queried[1])
        near = np.isfinite(distance)
        projected = np.sum((points[near] - dense[nearest[near]]) * inward[nearest[near]], axis=1)
        # close to the outline, the distance to the nearest point exceeds that to the line between the points
        distance[near] = np.where(distance[near] < 1.0, projected, np.copysign(distance[near], projected))
        return distance

    coarse = grid[_FINE // 2 :: _FINE, _FINE // 2 :: _FINE]
    mask = np.zeros(coarse.shape[:2], dtype=np.uint8)
    cv2.fillPoly(mask, [np.rint(outline).astype(np.int32)], 1)
    away = signed(coarse.reshape(-1, 2), reach).reshape(mask.shape)
    away = np.where(np.isfinite(away), away, np.where(mask == 1, reach, -reach))  # rounding is negligible there
    depth = np.asarray(cv2.resize(away, grid.shape[1::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float64)
    edge = np.abs(depth) < _EXACT
    depth[edge] = signed(grid[edge], np.inf)
    return depth


def _nearest(grid: Floats, points: Floats, reach: float) -> Floats:
    """Return the distance of each fine pixel to a set of points, infinite beyond `reach`."""
    tree = KDTree(points)
    around, _ = tree.query(grid[_FINE // 2 :: _FINE, _FINE // 2 :: _FINE], distance_upper_bound=reach + 1.0)
    near = np.repeat(np.repeat(np.isfinite(around), _FINE, axis=0), _FINE, axis=1)
    distance = np.full(grid.shape[:2], np.inf)
    distance[near], _ = tree.query(grid[near], distance_upper_bound=reach)
    return distance


def _light(shape: tuple[int, int], optics: Optics) -> Floats:
    y, x = (np.linspace(-1.0, 1.0, count)[:, None] for count in shape)
    away = 0.5 * (x.T**2 + y**2)
    return np.asarray((1.0 - optics.vignetting * away) * (1.0 + 0.5 * optics.unevenness * (x.T + y)))


def _on_camera(fine: Floats, blur: float) -> Floats:
    blurred = gaussian_filter(fine, _FINE * blur, mode="nearest") if blur > 0.0 else fine
    rows, columns = (count // _FINE for count in fine.shape)
    return np.asarray(blurred.reshape(rows, _FINE, columns, _FINE).mean(axis=(1, 3)))


def _exposed(light: Floats, frames: int, optics: Optics, random: np.random.Generator) -> NDArray[np.uint8]:
    """Return the mean grey levels of some frames: shot noise, then rounding to 8 bits."""
    counted = random.poisson(light * optics.electrons * frames) / (optics.electrons * frames)
    return np.clip(np.rint(optics.full_light * counted), 0, 255).astype(np.uint8)
