"""The concave rear of a capsule: a second dark band inside the outline, seen through the rim that hides it.

The middle of the band is taken for the membrane. Where no band is distinct from that of the outer edge, the rear may be
convex, or concave and not seen, and there is no result. Of a band that is wider than those of drawn pictures, the place
of the membrane within it is not known: its standard deviation is in the error of the depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import gaussian_filter1d

from capsbayes.arrays import Floats
from capsbayes.image.edges.models import Model, locate
from capsbayes.image.edges.robust import fit_without_outliers, median, wider_by_few

_BREADTH = 0.3  # of half the capsule's height: largest distance from the axis at which the band is followed
_DEPTH = 0.45  # of the capsule's length: largest distance from the rear end at which it is sought
_SMOOTHING = 1.5  # px
_STRIP = 3.0  # px: breadth of the strips in which the band is located
_FEWEST = 4  # strips
_FLOOR, _SCATTER = 0.02, 1.0  # px: smallest and largest spread of the strips about the parabola
_BEHIND = 10  # px behind the band within which it must brighten again
_REACH = 1.7, 5, 14  # half width of the fit around the band: over its deviation, at least and at most in px
_PROMINENCE = 0.02  # of the light, at least
_SIGNIFICANCE = 6.0  # of the prominence over its noise
_CURVATURES = np.linspace(-2.4, 0.2, 14)  # over the capsule's half height: off the axis the rear is less deep
_FRONT = 0.5  # of the capsule's length: a concave rear is never as deep as that from the nose
_RESOLVED = 60.0  # px: shortest capsule in which a second nose is sought; cells of 36 px show dark structures
_NOSES = np.linspace(0.4, 2.0, 5)  # over the capsule's half height: curvatures of a second nose
_CLEAR = 3.0  # of the band's deviation: nearer to the end of the silhouette it merges with the band of the outer edge
_OVERLAP, _FADING = 0.08, 2.5  # of the deviation: shift by the outer edge's band, and distance at which it fades
_WIDE = 3.5  # px: deviation from which on a band is wider than a line in focus; of 40 drawn ones it is 3.0 at most
_MISFIT = 0.02  # of the width of the band: how far the model's middle may be from that of the band


@dataclass(frozen=True, eq=False)
class RearBand:
    """Dark band of a concave rear, where it crosses the axis.

    Parameters
    ----------
    depth, depth_error : float [px]
        From the rear end of the capsule to the middle of the band on the axis, and its standard error.
    systematic : float [px^2]
        The part of the error's square that is the same in all pictures of a capsule.
    width : float [px]
        Standard deviation of the band.
    within : float [px]
        The part of the error that is the place of the membrane within a wide band; 0 in a narrow one.
    curvature : float [1/px]
        Second derivative of the depth across the axis.
    breadth : float [px]
        Distance from the axis up to which it was followed.
    """

    depth: float
    depth_error: float
    systematic: float
    width: float
    within: float
    curvature: float
    breadth: float


def find_rear(
    light: Floats, end: Floats, inwards: Floats, length: float, half_height: float, blur: float, noise: float
) -> RearBand | None:
    """Find the dark band of a concave rear.

    Parameters
    ----------
    light : (rows, columns) array
        Light over that of the empty channel.
    end : (2,) array [px]
        Rear end (x, y) of the silhouette, on the axis.
    inwards : (2,) array
        Unit vector from there to the nose.
    length, half_height : float [px]
        Of the silhouette.
    blur : float [px]
        Standard deviation of the blur across the axis.
    noise : float
        Standard deviation of one pixel of `light`.
    """
    rays, y = _rays(light, end, inwards, _DEPTH * length, half_height)
    start = _coarse(rays, y, _CURVATURES / half_height, noise)
    return None if start is None else _fine(rays, y, start, blur, noise)


def shows_second_nose(
    light: Floats, nose: Floats, inwards: Floats, length: float, half_height: float, noise: float
) -> bool:
    """Return whether a dark band as of a second nose is seen inside the front half of a capsule.

    Two capsules overlap there. The arguments are those of `find_rear`, with the nose in place of the rear end. In a
    small cell, what lies in it is not distinct from a nose, and none is sought.
    """
    if length < _RESOLVED:
        return False
    rays, y = _rays(light, nose, inwards, _FRONT * length, half_height)
    return _coarse(rays, y, _NOSES / half_height, noise, behind_rim=True) is not None


def _rays(light: Floats, end: Floats, inwards: Floats, depth: float, half_height: float) -> tuple[Floats, Floats]:
    """Return the light along rays (r, u) from an end inwards, a pixel apart, and their distances (r,) from the axis."""
    breadth = _BREADTH * half_height
    y = np.arange(-np.floor(breadth), np.floor(breadth) + 1.0)
    return _along_rays(light, end, inwards, math.ceil(depth), y), y


@njit(cache=True, nogil=True, error_model="numpy")
def _along_rays(light, end, inwards, count, y):  # type: ignore[no-untyped-def]
    """Return the light, linear between pixels, at so many distances inwards, a pixel apart, for each y : (r, u)."""
    rows, columns = light.shape
    rays = np.empty((len(y), count))
    for r in range(len(y)):
        for u in range(count):
            column = min(max(end[0] + u * inwards[0] - y[r] * inwards[1], 0.0), columns - 1.0)
            row = min(max(end[1] + u * inwards[1] + y[r] * inwards[0], 0.0), rows - 1.0)
            i, j = min(int(row), rows - 2), min(int(column), columns - 2)
            down, right = row - i, column - j
            upper = (1.0 - right) * light[i, j] + right * light[i, j + 1]
            lower = (1.0 - right) * light[i + 1, j] + right * light[i + 1, j + 1]
            rays[r, u] = (1.0 - down) * upper + down * lower
    return rays


def _coarse(
    rays: Floats, y: Floats, curvatures: Floats, noise: float, *, behind_rim: bool = False
) -> tuple[int, float, float] | None:
    """Return the depth of a band on the axis, its curvature, and its standard deviation, to a pixel.

    Behind the rim, only a band is sought that another one, that of the outer edge, is seen in front of.
    """
    bend = np.rint(0.5 * curvatures[:, None] * y**2).astype(np.int64)
    smooth = gaussian_filter1d(_stacked(rays, bend), _SMOOTHING, axis=1, mode="nearest")
    least = max(_PROMINENCE, _SIGNIFICANCE * noise / np.sqrt(len(y)))
    row, dip, prominence = _most_prominent(smooth, least, behind_rim)
    if row < 0:
        return None
    return dip, float(curvatures[row]), _deviation(smooth[row], dip, 0.5 * prominence)


@njit(cache=True, nogil=True, error_model="numpy")
def _stacked(rays, bend):  # type: ignore[no-untyped-def]
    """Return the mean of the rays (r, u), each shifted by its bend, for each row of bends (c, r) : (c, u) array."""
    last = rays.shape[1] - 1
    stacked = np.zeros((len(bend), last + 1))
    for c in range(len(bend)):
        for r in range(len(rays)):
            for u in range(last + 1):
                stacked[c, u] += rays[r, min(max(u + bend[c, r], 0), last)]
    return stacked / len(rays)


@njit(cache=True, nogil=True, error_model="numpy")
def _most_prominent(profiles, least, behind_rim):  # type: ignore[no-untyped-def]
    """Return the row and the place of the most prominent dip in profiles (c, u), and its prominence; row -1 if none."""
    best, row, place = least, -1, -1
    for c in range(len(profiles)):
        profile = profiles[c]
        for dip in range(1, len(profile) - 1):
            if profile[dip] >= profile[dip - 1] or profile[dip] > profile[dip + 1]:
                continue
            rim = np.argmin(profile[: max(dip // 2, 1)])  # the dark band of the outer edge
            if behind_rim and (rim == 0 or profile[rim + 1] < profile[rim]):
                continue  # the dip is that band itself
            before, behind = profile[rim:dip].max(), profile[dip : dip + _BEHIND + 1].max()
            prominence = min(before, behind) - profile[dip]
            if prominence > best:
                best, row, place = prominence, c, dip
    return row, place, best


def _deviation(profile: Floats, dip: int, half: float) -> float:
    """Return the standard deviation of a band, from its width at half its prominence."""
    bright = np.flatnonzero(profile > profile[dip] + half)
    return float(bright[bright > dip].min() - bright[bright < dip].max() - 1) / 2.355


def _fine(rays: Floats, y: Floats, start: tuple[int, float, float], blur: float, noise: float) -> RearBand | None:
    """Locate the band in strips along the axis, and fit a parabola to the places."""
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
    bands = locate(means, samples.astype(float), Model.BAND, np.zeros(strips), np.full(strips, deviation), used)
    across = np.add.reduceat(y, first) / count
    fit = fit_without_outliers(
        np.stack([np.ones(strips), across, 0.5 * across**2], axis=1),
        np.add.reduceat(centre.astype(float), first) / count + bands.place,
        bands.converged & (bands.coefficients[:, 0] < 0.0) & (np.abs(bands.place) < 0.5 * reach),
        rounds=2,
        floor=_FLOOR,
        enough=lambda kept: kept.sum() >= _FEWEST,
    )
    if fit is None or fit.kept.sum() < _FEWEST or fit.spread > _SCATTER:
        return None
    expected = noise**2 * median(bands.place_variance[fit.kept] / count[fit.kept])
    free = int(fit.kept.sum()) - fit.design.shape[1]
    variance = fit.cofactor[0, 0] * max(expected, wider_by_few(free) ** 2 * fit.variance)
    depth = float(fit.coefficients[0] - 0.5 * fit.coefficients[2] * blur**2)
    if depth < _CLEAR * deviation:
        return None
    misfit = deviation * (_MISFIT + _OVERLAP * np.exp(-(depth / deviation - _CLEAR) / _FADING))
    within = _place_within(deviation, blur)
    systematic = float(misfit**2 + within**2)
    breadth = float(np.max(np.abs(across[fit.kept])))
    error = float(np.sqrt(variance + systematic))
    return RearBand(depth, error, systematic, deviation, within, float(fit.coefficients[2]), breadth)


def _place_within(deviation: float, blur: float) -> float:
    """Return the standard error of the membrane's place within a band of this standard deviation, see `RearBand`."""
    of_band = float(np.sqrt(max(deviation**2 - blur**2 - _SMOOTHING**2, 0.0)))
    return of_band if of_band > _WIDE else 0.0
