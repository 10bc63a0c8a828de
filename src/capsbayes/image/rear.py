"""The concave rear of a capsule: a second dark band inside the outline, seen through the rim that hides it.

The middle of the band is taken for the membrane. Where no band stands clear of that of the outer edge, the rear may be
convex, or concave and not seen: nothing is said then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

from capsbayes.image.edge_models import Model, locate

__all__ = ["RearBand", "find_rear"]

Floats = NDArray[np.float64]

_BREADTH = 0.3  # of half the capsule's height: how far from the axis the band is followed
_DEPTH = 0.45  # of the capsule's length: how far from the rear end it is looked for
_SMOOTHING = 1.5  # px
_STRIP = 3.0  # px: breadth of the strips in which the band is located
_BEHIND = 10  # px behind the band in which it must have brightened again
_REACH = 1.7, 5, 14  # how much around the band is fitted: over its deviation, and at least and at most in px
_PROMINENCE = 0.02  # of the light, at least
_SIGNIFICANCE = 6.0  # of the prominence over its noise
_CURVATURES = np.linspace(-2.4, 0.2, 14)  # over the capsule's half height: away from the axis the rear lies less deep
_CLEAR = 3.0  # of the band's deviation: nearer to the end of the silhouette it merges with the band of the outer edge
_OVERLAP, _FADING = 0.08, 2.5  # what the band of the outer edge shifts this one by, over its deviation, and how far
_MISFIT = 0.02  # of the width of the band: how far the model's middle may be from that of the band


@dataclass(frozen=True, eq=False)
class RearBand:
    """Where the rear crosses the axis.

    Parameters
    ----------
    depth, depth_error : float [px]
        From the rear end of the capsule to the middle of the band on the axis, and its standard error.
    lasting : float [px^2]
        The part of the error's square that is the same in all pictures of a capsule.
    width : float [px]
        Standard deviation of the band.
    curvature : float [1/px]
        Second derivative of the depth across the axis.
    breadth : float [px]
        How far from the axis it was followed.
    """

    depth: float
    depth_error: float
    lasting: float
    width: float
    curvature: float
    breadth: float


def find_rear(
    light: Floats, end: Floats, inwards: Floats, length: float, half_height: float, blur: float, noise: float
) -> RearBand | None:
    """Find the band.

    Parameters
    ----------
    light : (rows, columns) array
        Share of the light of the empty channel.
    end : (2,) array [px]
        Point (x, y) on the axis at which the silhouette ends.
    inwards : (2,) array
        Unit vector from there to the nose.
    length, half_height : float [px]
        Of the silhouette.
    blur : float [px]
        Standard deviation of the blur across the axis.
    noise : float
        Standard deviation of one pixel of `light`.

    Returns
    -------
    RearBand or None
    """
    across = np.array([-inwards[1], inwards[0]])
    breadth = _BREADTH * half_height
    y = np.arange(-np.floor(breadth), np.floor(breadth) + 1.0)
    u = np.arange(0.0, _DEPTH * length)
    at = end + u[:, None] * inwards + y[:, None, None] * across
    rays = map_coordinates(light, [at[..., 1], at[..., 0]], order=1, mode="nearest")
    start = _coarse(rays, y, half_height, noise)
    if start is None:
        return None
    return _fine(rays, y, start, blur, noise)


def _coarse(rays: Floats, y: Floats, half_height: float, noise: float) -> tuple[int, float, float] | None:
    """Depth of the band on the axis, its curvature, and its standard deviation, to a pixel."""
    bend = np.rint(0.5 * _CURVATURES[:, None] / half_height * y**2).astype(np.int64)
    stacked = _stacked(np.ascontiguousarray(rays), bend)
    smooth = gaussian_filter1d(stacked, _SMOOTHING, axis=1, mode="nearest")
    best, found = max(_PROMINENCE, _SIGNIFICANCE * noise / np.sqrt(len(y))), None
    for curvature, profile in zip(_CURVATURES / half_height, smooth, strict=True):
        dips = (profile[1:-1] < profile[:-2]) & (profile[1:-1] <= profile[2:])
        for dip in (int(index) + 1 for index in np.flatnonzero(dips)):
            rim = int(np.argmin(profile[: max(dip // 2, 1)]))  # the dark band of the outer edge
            before, behind = profile[rim:dip].max(), profile[dip : dip + _BEHIND + 1].max()
            prominence = min(before, behind) - profile[dip]
            if prominence > best:
                best, found = (
                    float(prominence),
                    (dip, float(curvature), _deviation(profile, dip, 0.5 * prominence)),
                )
    return found


@njit(cache=True, nogil=True)
def _stacked(rays, bend):  # type: ignore[no-untyped-def]
    """Mean of the rays, each moved by what a curvature bends it : (curvatures, points) array."""
    last = rays.shape[1] - 1
    stacked = np.zeros((len(bend), last + 1))
    for n in range(len(bend)):
        for ray in range(len(rays)):
            for i in range(last + 1):
                stacked[n, i] += rays[ray, min(max(i + bend[n, ray], 0), last)]
    return stacked / len(rays)


def _deviation(profile: Floats, dip: int, half: float) -> float:
    """Standard deviation of a band from its width at half its prominence."""
    bright = np.flatnonzero(profile > profile[dip] + half)
    return float(bright[bright > dip].min() - bright[bright < dip].max() - 1) / 2.355


def _fine(rays: Floats, y: Floats, start: tuple[int, float, float], blur: float, noise: float) -> RearBand | None:
    """Locate the band in strips beside the axis, and lay a parabola through what was found."""
    middle, curvature, deviation = start
    share, least, most = _REACH
    reach = int(np.clip(round(share * deviation), least, most))
    strips = max(5, round(len(y) / _STRIP))
    strip = np.arange(len(y)) * strips // len(y)
    first = np.flatnonzero(np.diff(strip, prepend=-1))
    count = np.bincount(strip)
    centre = middle + np.rint(0.5 * curvature * y**2).astype(int)
    samples = np.arange(-reach, reach + 1)
    index = centre[:, None] + samples
    within = (index >= 2) & (index < rays.shape[1])
    values = np.take_along_axis(rays, np.clip(index, 0, rays.shape[1] - 1), axis=1)
    means = np.add.reduceat(values, first, axis=0) / count[:, None]
    used = np.minimum.reduceat(within, first, axis=0).astype(float)
    found = locate(means, samples.astype(float), Model.BAND, np.zeros(strips), np.full(strips, deviation), used)
    across = np.add.reduceat(y, first) / count
    height = np.add.reduceat(centre.astype(float), first) / count + found.place
    sound = found.converged & (found.coefficients[:, 0] < 0.0) & (np.abs(found.place) < 0.5 * reach)
    for _ in range(2):
        if sound.sum() < 4:
            return None
        design = np.stack([np.ones(strips), across, 0.5 * across**2], axis=1)
        solution, *_ = np.linalg.lstsq(design[sound], height[sound], rcond=None)
        residual = height - design @ solution
        scatter = max(1.4826 * float(np.median(np.abs(residual[sound]))), 0.02)
        sound &= np.abs(residual) < 4.0 * scatter
    if sound.sum() < 4 or scatter > 1.0:
        return None
    counted = noise**2 * np.median(found.place_variance[sound] / count[sound])
    seen = np.sum(residual[sound] ** 2) / max(int(sound.sum()) - 3, 1)
    variance = np.linalg.inv(design[sound].T @ design[sound])[0, 0] * max(counted, seen)
    depth = float(solution[0] - 0.5 * solution[2] * blur**2)
    if depth < _CLEAR * deviation:
        return None
    misfit = deviation * (_MISFIT + _OVERLAP * np.exp(-(depth / deviation - _CLEAR) / _FADING))
    error = float(np.sqrt(variance + misfit**2))
    return RearBand(depth, error, float(misfit**2), deviation, float(solution[2]), float(np.max(np.abs(across[sound]))))
