"""Pictures of simulated capsules as a camera sees them, with the truth beside them.

This renderer shares no code with the library's edges or with its own drawings: shapes are polygons, whose coverage of
fine pixels is summed from their sides; membranes and halos are stacks of polygons moved along their normals; lens,
motion and pixels are transfer functions, multiplied in Fourier space; what the camera makes of the light follows.

Positions are (x, y) in pixels, x to the right and y down, the centre of the first pixel at (0, 0).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import j1

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]

FINE = 4  # fine pixels along the side of one of the camera's
LINES = 2  # lines of a fine pixel along which coverage is summed
LAYERS = 7  # polygons in a stack
_RINGS = 24  # polygons from which rings are made
MARGIN = 36.0  # px around the capsule along the channel


@dataclass(frozen=True, eq=False)
class Capsule:
    """Shape of a capsule, and its place."""

    profile: Floats  # outline (p, 2) in the plane of the axis [l]; columns (z, y), z along the flow
    silhouette: Floats  # as seen from the side
    centre: tuple[float, float]  # place (x, y) of the middle of its length [px]


@dataclass(frozen=True)
class Looks:
    """Capsule and channel in the light: darknesses are fractions of the full light, lengths are in pixels."""

    interior: float = 0.2  # darkness of the capsule within its membrane
    membrane: float = 0.4  # darkness added at the outer edge
    membrane_width: float = 4.0  # depth at which it has fallen to 1/e
    line: float = 0.0  # half the breadth, where it is half as dark, of a membrane seen as a line about the edge; 0: not
    rear: float = 0.35  # darkness of the membrane of a concave rear
    rear_width: float = 2.5  # half its breadth, where it is half as dark
    halo: float = 0.04  # light added just outside the edge
    halo_width: float = 2.5  # distance at which it has fallen to 1/e
    ring: float = 0.0  # wavelength of its rings, 0 for none
    ring_phase: float = 0.0  # at the edge [rad]
    wall: float = 0.5  # darkness of a wall's band
    wall_width: float = 2.0  # half its breadth, where it is half as dark
    beyond: float = 0.93  # light beyond the walls
    unevenness: float = 0.05  # light gained from the left border of the picture to the right one


@dataclass(frozen=True)
class Camera:
    """Lens, exposure and electronics."""

    blur: float = 0.7  # standard deviation of a Gaussian blur [px]
    defocus: float = 0.0  # radius of the disc as which a point is seen [px]
    motion: float = 0.0  # way of the capsule during the exposure [px]
    photons: float = 20_000.0  # counted by a pixel at the full light
    constant_noise: float = 0.002  # standard deviation of the noise in the dark, over the full light
    full_light: float = 190.0  # its grey level
    median: int = 1  # side of the median filter [px]; 1 for none
    jpeg: int | None = None  # quality with which the picture is compressed
    inverted: bool = False  # dark and bright exchanged
    empty_frames: int = 16  # averaged to the picture of the empty channel


@dataclass(frozen=True, eq=False)
class View:
    """What stands in front of the camera."""

    capsules: tuple[Capsule, ...]  # the first is the one to measure
    half_width: float  # of the channel [px]
    shape: tuple[int, int]  # rows and columns of the picture
    tilt: float = 0.0  # angle of the channel to the rows, from x towards y [rad]
    flow: int = 1  # 1 to the right, -1 to the left
    looks: Looks = field(default_factory=Looks)

    @property
    def along(self) -> Floats:
        """Unit vector (x, y) downstream."""
        return self.flow * np.array([np.cos(self.tilt), np.sin(self.tilt)])

    @property
    def across(self) -> Floats:
        """Unit vector (x, y) from the middle of the channel to the lower wall."""
        return np.array([-np.sin(self.tilt), np.cos(self.tilt)])

    @property
    def axial_extent(self) -> float:
        """L_z of the silhouette [px]."""
        return self.half_width * float(np.ptp(self.capsules[0].silhouette[:, 0]))

    @property
    def axial_length(self) -> float:
        """L_a [px]: from the nose to where the rear crosses the axis."""
        return self.half_width * (float(self.capsules[0].profile[:, 0].max()) - _on_axis(self.capsules[0].profile))

    def placed(self, points: Floats, capsule: Capsule) -> Floats:
        """Return points (z, y) [l] of a capsule as positions (x, y) [px] : (p, 2) arrays."""
        ends = capsule.silhouette[:, 0]
        z = points[:, 0] - 0.5 * (ends.max() + ends.min())
        local = z[:, None] * self.along + points[:, 1:] * self.across
        return np.asarray(capsule.centre + self.half_width * local)


def photograph(view: View, camera: Camera, *, seed: int) -> tuple[Grey, Grey]:
    """Return the picture of a view, and that of its channel empty : (rows, columns) arrays."""
    random = np.random.default_rng(seed)
    lens = camera.blur, camera.defocus
    return (
        recorded(_seen(view, *lens, camera.motion), camera, 1, random),
        recorded(_seen(view, *lens, None), camera, camera.empty_frames, random),
    )


@lru_cache(maxsize=16)  # cameras that differ in noise or software alone
def _seen(view: View, blur: float, defocus: float, motion: float | None) -> Floats:
    """Return the light on the pixels, through a lens; that of the empty channel where the motion is None."""
    light, capsules = _light_of(view)
    if motion is not None:
        light = light * (seen_through(capsules, _motion(motion, view.along)) if motion else capsules)
    return on_pixels(light, view, Camera(blur=blur, defocus=defocus))


def film(view: View, camera: Camera, steps: Floats, *, seed: int) -> tuple[list[Grey], Grey]:
    """Return a picture for each way [px] that the capsules have gone downstream, and that of the empty channel."""
    random = np.random.default_rng(seed)
    channel, capsules = _light_of(view)
    frames = []
    for step in steps:
        transfer = _shift(step, view.along)
        blurred = _product(transfer, _motion(camera.motion, view.along)) if camera.motion else transfer
        light = on_pixels(channel * seen_through(capsules, blurred), view, camera)
        frames.append(recorded(light, camera, 1, random))
    return frames, recorded(on_pixels(channel, view, camera), camera, camera.empty_frames, random)


@lru_cache(maxsize=1)  # of several cameras before one view
def _light_of(view: View) -> tuple[Floats, Floats]:
    """Return the light of the empty channel, and the transmission of all capsules."""
    return channel_of(view), np.prod([transmission_of(view, capsule) for capsule in view.capsules], axis=0)


def channel_of(view: View) -> Floats:
    """Return the light of the empty channel on the fine pixels : (4 rows, 4 columns) array."""
    looks, (rows, columns) = view.looks, view.shape
    x, y = ((np.arange(FINE * count) + 0.5) / FINE - 0.5 * count for count in (columns, rows))
    off = np.abs(x * view.across[0] + y[:, None] * view.across[1]) - view.half_width
    light = 1.0 - (1.0 - looks.beyond) * np.clip(0.5 + FINE * off, 0.0, 1.0)
    light -= looks.wall * np.clip(1.5 - np.abs(off) / looks.wall_width, 0.0, 1.0)
    return np.asarray(light * (1.0 + looks.unevenness * np.linspace(-0.5, 0.5, FINE * columns)))


def transmission_of(view: View, capsule: Capsule) -> Floats:
    """Return the transmission of a capsule on the fine pixels : (4 rows, 4 columns) array."""
    looks = view.looks
    outline = _even(view.placed(capsule.silhouette, capsule), closed=True)
    normals = _normals(outline, closed=True)
    if _area(outline) < 0.0:
        normals = -normals

    def moved(outwards: float) -> Floats:
        return covered(outline + outwards * normals, view.shape)

    inside = moved(0.0)
    if looks.line:
        breadths = looks.line * (0.5 + _shares())
        membrane = np.mean([moved(breadth) - moved(-breadth) for breadth in breadths], axis=0)
    else:
        depths = -np.log(_shares())  # of these the mean falls as exp(-depth)
        membrane = inside - np.mean([moved(-looks.membrane_width * depth) for depth in depths], axis=0)
    dark = looks.interior * inside + looks.membrane * membrane
    dark += looks.rear * inside * _rear(view, capsule)
    return np.asarray(1.0 - dark + looks.halo * _around(looks, inside, moved))


def _around(looks: Looks, inside: Floats, moved: Callable[[float], Floats]) -> Floats:
    """Return the light outside the edge over that of the halo at it, on the fine pixels."""
    if not looks.ring:
        return np.asarray(np.mean([moved(looks.halo_width * depth) for depth in -np.log(_shares())], axis=0) - inside)
    ends = looks.halo_width * np.linspace(0.0, 4.0, _RINGS + 1)
    middles = 0.5 * (ends[1:] + ends[:-1])
    waves = np.cos(2.0 * np.pi * middles / looks.ring + looks.ring_phase) * np.exp(-middles / looks.halo_width)
    layers = np.array([inside, *map(moved, ends[1:])])
    return np.asarray(np.tensordot(waves, np.diff(layers, axis=0), axes=1))


def _rear(view: View, capsule: Capsule) -> Floats:
    """Return the darkness of the membrane of a concave rear, 1 in its middle, on the fine pixels."""
    profile = capsule.profile
    ends = sorted(
        int(np.flatnonzero(side)[np.argmin(profile[side, 0])]) for side in (profile[:, 1] >= 0.0, profile[:, 1] < 0.0)
    )
    if ends[1] - ends[0] < 4:
        return np.zeros([FINE * count for count in view.shape])
    line = _even(view.placed(profile[ends[0] : ends[1] + 1], capsule), closed=False)
    normals = _normals(line, closed=False)
    breadths = view.looks.rear_width * (0.5 + _shares())  # dark in the middle, fainter towards both borders
    strokes = [np.concatenate([line - b * normals, (line + b * normals)[::-1]]) for b in breadths]
    return np.asarray(np.mean([covered(stroke, view.shape) for stroke in strokes], axis=0))


def _shares() -> Floats:
    """Return the middles of equal parts of (0, 1), one for each polygon of a stack."""
    return (np.arange(LAYERS) + 0.5) / LAYERS


def covered(polygon: Floats, shape: tuple[int, int]) -> Floats:
    """Return the share of each fine pixel of a picture that a polygon (p, 2) [px] covers, in either sense.

    Along each line, a side that crosses it adds its sign to all that lies to the right of the crossing. Loops that turn
    the other way, as of an offset where the curve is tight, count nothing.
    """
    whole = np.zeros([FINE * count for count in shape])
    low = np.clip(np.floor(polygon.min(axis=0) + 0.5).astype(int), 0, shape[::-1])
    high = np.clip(np.ceil(polygon.max(axis=0) + 0.5).astype(int), low, shape[::-1])
    columns, rows = FINE * (high - low)
    x, y = (FINE * (polygon + 0.5 - low) * [1.0, LINES]).T
    x_next, y_next = np.roll(x, -1), np.roll(y, -1)
    first, last = (  # lines at the middles first .. last - 1
        np.clip(np.ceil(end(y, y_next) - 0.5).astype(int), 0, rows * LINES) for end in (np.minimum, np.maximum)
    )
    count = last - first
    side = np.repeat(np.arange(len(x)), count)
    line = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count) + first[side]
    share = (line + 0.5 - y[side]) / (y_next[side] - y[side])
    crossing = np.clip(x[side] + share * (x_next[side] - x[side]), 0.0, columns)
    sign = np.where(y_next[side] > y[side], -np.sign(_area(polygon)), np.sign(_area(polygon)))
    column = np.floor(crossing).astype(int)
    part = crossing - column
    at = line * (columns + 2) + column
    size = rows * LINES * (columns + 2)
    stored = np.bincount(at, sign * (1.0 - part), size) + np.bincount(at + 1, sign * part, size)
    winding = np.cumsum(stored.reshape(rows * LINES, columns + 2), axis=1)[:, :columns]
    part_covered = np.clip(winding, 0.0, 1.0).reshape(rows, LINES, columns).mean(axis=1)
    whole[FINE * low[1] : FINE * high[1], FINE * low[0] : FINE * high[0]] = part_covered
    return whole


Transfer = Callable[[Floats, Floats], NDArray[np.complex128] | Floats]


def seen_through(light: Floats, transfer: Transfer) -> Floats:
    """Multiply the Fourier transform of an image by a function of the frequencies (x, y) in cycles per pixel.

    The image is mirrored at its borders first, as its opposite sides would meet otherwise.
    """
    least = 16 * FINE
    shape = [fft.next_fast_len(count + least, real=True) for count in light.shape]
    before = [(size - count) // 2 for size, count in zip(shape, light.shape, strict=True)]
    after = [size - count - start for size, count, start in zip(shape, light.shape, before, strict=True)]
    wide = np.pad(light, tuple(zip(before, after, strict=True)), mode="reflect")
    fx, fy = fft.rfftfreq(shape[1], 1.0 / FINE), fft.fftfreq(shape[0], 1.0 / FINE)
    seen = fft.irfft2(fft.rfft2(wide) * transfer(fx[None, :], fy[:, None]), shape)
    return np.asarray(seen[before[0] : before[0] + light.shape[0], before[1] : before[1] + light.shape[1]])


def _product(first: Transfer, second: Transfer) -> Transfer:
    return lambda fx, fy: first(fx, fy) * second(fx, fy)


def _motion(way: float, along: Floats) -> Transfer:
    return lambda fx, fy: np.sinc(way * (fx * along[0] + fy * along[1]))


def _shift(way: float, along: Floats) -> Transfer:
    return lambda fx, fy: np.exp(-2j * np.pi * way * (fx * along[0] + fy * along[1]))


def _lens(camera: Camera) -> Transfer:
    def transfer(fx: Floats, fy: Floats) -> Floats:
        squared = fx**2 + fy**2
        radius = 2.0 * np.pi * camera.defocus * np.sqrt(squared)
        disc = np.where(radius < 1e-6, 1.0, 2.0 * j1(radius) / np.where(radius < 1e-6, 1.0, radius))
        return np.asarray(np.exp(-2.0 * (np.pi * camera.blur) ** 2 * squared) * disc)

    return transfer


def on_pixels(light: Floats, view: View, camera: Camera) -> Floats:
    """Return the light on each pixel, behind the lens : (rows, columns) array."""
    rows, columns = view.shape
    return np.asarray(seen_through(light, _lens(camera)).reshape(rows, FINE, columns, FINE).mean(axis=(1, 3)))


def recorded(light: Floats, camera: Camera, frames: int, random: np.random.Generator) -> Grey:
    """Return the grey levels of the mean of some frames: noise, rounding, then what software does."""
    counted = random.poisson(np.maximum(light, 0.0) * camera.photons * frames) / (camera.photons * frames)
    counted = counted + camera.constant_noise / np.sqrt(frames) * random.standard_normal(counted.shape)
    levels = np.clip(np.rint(camera.full_light * counted), 0, 255).astype(np.uint8)
    if camera.inverted:
        levels = 255 - levels
    if camera.median > 1:
        levels = np.asarray(cv2.medianBlur(levels, camera.median), dtype=np.uint8)
    if camera.jpeg is not None:
        _, packed = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
        levels = np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
    return levels


def beside(view: View, along: float, across: float) -> View:
    """Return a view with a second capsule of the same shape, displaced from the first [px]."""
    first = view.capsules[0]
    centre = first.centre + along * view.along + across * view.across
    return replace(view, capsules=(first, replace(first, centre=(float(centre[0]), float(centre[1])))))


def _area(polygon: Floats) -> float:
    """Return the area within a polygon, positive where x turns towards y."""
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _even(points: Floats, *, closed: bool) -> Floats:
    """Return points a third of a pixel apart along a curve."""
    corners = np.vstack([points, points[:1]]) if closed else points
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    at = np.linspace(0.0, way[-1], int(3.0 * way[-1]), endpoint=not closed)
    return np.stack([np.interp(at, way, corners[:, axis]) for axis in (0, 1)], axis=1)


def _normals(points: Floats, *, closed: bool) -> Floats:
    """Return unit normals, outwards of a closed curve of positive area."""
    reach = 3
    wide = np.pad(points, ((reach, reach), (0, 0)), mode="wrap" if closed else "edge")
    tangent = wide[2 * reach :] - wide[: -2 * reach]
    tangent = tangent / np.hypot(*tangent.T)[:, None]
    return np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)


def _on_axis(profile: Floats) -> float:
    """Return the smaller z at which a closed profile crosses its axis y = 0 : the rear."""
    z, y = profile.T
    z_next, y_next = np.roll(z, -1), np.roll(y, -1)
    crosses = (y >= 0.0) != (y_next >= 0.0)
    at = z[crosses] + (z_next - z)[crosses] * (-y[crosses]) / (y_next - y)[crosses]
    return float(at.min())
