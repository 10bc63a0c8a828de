"""The concave rear of a capsule: a second dark band inside the outline, seen through the rim that hides it.

The middle of the band is taken for the membrane. Where no band stands clear of that of the outer edge, the rear may be
convex, or concave and not seen: nothing is said then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

from capsbayes.image.edge_models import band, locate

__all__ = ["RearBand", "find_rear"]

Floats = NDArray[np.float64]

_BREADTH = 0.3  # of half the capsule's height: how far from the axis the band is followed
_DEPTH = 0.45  # of the capsule's length: how far from the rear end it is looked for
_SMOOTHING = 1.5  # px
_STRIP = 3.0  # px: breadth of the strips in which the band is located
_REACH = 5  # px around the band that are fitted
_PROMINENCE = 0.02  # of the light, at least
_SIGNIFICANCE = 6.0  # of the prominence over its noise
_CURVATURES = np.linspace(-0.3, 1.2, 16)  # over the capsule's half height
_CLEAR = 3.0  # of the band's deviation: nearer to the end of the silhouette it merges with the band of the outer edge
_MISFIT = 0.02  # of the width of the band: how far the model's middle may be from that of the band


@dataclass(frozen=True, eq=False)
class RearBand:
    """Where the rear crosses the axis.

    Parameters
    ----------
    depth, depth_error : float [px]
        From the rear end of the capsule to the middle of the band on the axis, and its standard error.
    width : float [px]
        Standard deviation of the band.
    curvature : float [1/px]
        Second derivative of the depth across the axis.
    breadth : float [px]
        How far from the axis it was followed.
    """

    depth: float
    depth_error: float
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


def _coarse(rays: Floats, y: Floats, half_height: float, noise: float) -> tuple[int, float] | None:
    """Depth of the band on the axis and its curvature, to a pixel."""
    u = np.arange(rays.shape[1])
    best: tuple[float, int, float] | None = None
    for curvature in _CURVATURES / half_height:
        shifted = u + np.rint(0.5 * curvature * y[:, None] ** 2).astype(int)
        stacked = np.take_along_axis(rays, np.clip(shifted, 0, len(u) - 1), axis=1).mean(axis=0)
        smooth = gaussian_filter1d(stacked, _SMOOTHING, mode="nearest")
        for dip in np.flatnonzero((smooth[1:-1] < smooth[:-2]) & (smooth[1:-1] <= smooth[2:])) + 1:
            prominence = min(smooth[:dip].max(initial=0.0), _highest(smooth[dip:])) - smooth[dip]
            edge_dip = int(np.argmin(smooth[: max(dip // 2, 1)]))
            clear = smooth[edge_dip:dip].max(initial=0.0) - smooth[dip]
            prominence = min(prominence, clear)
            if best is None or prominence > best[0]:
                best = (float(prominence), int(dip), float(curvature))
    if best is None or best[0] < max(_PROMINENCE, _SIGNIFICANCE * noise / np.sqrt(len(y))):
        return None
    return best[1], best[2]


def _highest(after: Floats) -> float:
    """Brightest of the few pixels behind a band: further in, the light has other reasons to change."""
    return float(after[: 2 * _REACH].max())


def _fine(rays: Floats, y: Floats, start: tuple[int, float], blur: float, noise: float) -> RearBand | None:
    """Locate the band in strips beside the axis, and lay a parabola through what was found."""
    middle, curvature = start
    strips = max(5, round(len(y) / _STRIP))
    strip = np.arange(len(y)) * strips // len(y)
    first = np.flatnonzero(np.diff(strip, prepend=-1))
    count = np.bincount(strip)
    centre = middle + np.rint(0.5 * curvature * y**2).astype(int)
    samples = np.arange(-_REACH, _REACH + 1)
    index = centre[:, None] + samples
    within = (index >= 2) & (index < rays.shape[1])
    values = np.take_along_axis(rays, np.clip(index, 0, rays.shape[1] - 1), axis=1)
    means = np.add.reduceat(values, first, axis=0) / count[:, None]
    used = np.minimum.reduceat(within, first, axis=0).astype(float)
    found = locate(means, samples.astype(float), band, np.zeros(strips), np.full(strips, 2.0), used)
    across = np.add.reduceat(y, first) / count
    height = np.add.reduceat(centre.astype(float), first) / count + found.place
    sound = found.converged & (found.coefficients[:, 0] < 0.0) & (np.abs(found.place) < 0.5 * _REACH)
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
    width = float(np.median(found.width[sound]))
    counted = noise**2 * np.median(found.place_variance[sound] / count[sound])
    seen = np.sum(residual[sound] ** 2) / max(int(sound.sum()) - 3, 1)
    variance = np.linalg.inv(design[sound].T @ design[sound])[0, 0] * max(counted, seen)
    depth = float(solution[0] - 0.5 * solution[2] * blur**2)
    if depth < _CLEAR * width:
        return None
    error = float(np.sqrt(variance + (_MISFIT * width) ** 2))
    return RearBand(depth, error, width, float(solution[2]), float(np.max(np.abs(across[sound]))))
