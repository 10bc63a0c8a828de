"""The edge of a capsule: its outline, ends and rear, located to a fraction of a pixel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter, gaussian_filter1d, map_coordinates, median_filter, spline_filter
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.edge_models import (
    Model,
    ProfileFit,
    bridge_errors,
    bridged,
    curvatures,
    fit_without_outliers,
    locate,
    mean_squares,
    means_of_arcs,
    median,
    misfit_around,
    quantile,
    robust_spread,
    rounded,
    sampled,
    smooth_curve,
    wider_by_few,
)
from capsbayes.profile import arc_length, edge_lengths, equally_spaced, following, signed_area, vertex_normals
from capsbayes.quantity import Quantity

# A closed curve around the dark blob is moved to where the intensity along its normals jumps: the jump is located in
# means over arcs of the curve, and the shift of each normal against the mean of its arc is fitted to their difference

_SPACING = 1.25  # px between normals
ARC = 18.0  # px: length of the arcs that share one shape of the edge
# length of the arcs, and the deviation [px] of a Gaussian that smooths the picture: what is too sharp for its pixels is
# smoothed; what is too faint too, then in longer arcs
_ATTEMPTS = (ARC, 0.0), (ARC, 0.6), (2.0 * ARC, 0.6), (4.0 * ARC, 0.6)
_SHARP = 0.4  # px: edges less wide than that lie between two pixels
_REACH = 9  # px along a normal, to either side
_SMOOTHING = 2.0  # px: of the curve on which the normals stand
_START_WIDTH = 1.5  # px
AVERAGED = 3  # points: the errors of their means are almost independent
_SCATTER = 0.75, 0.15  # variance of their mean over that of independent points: at zero width, and per width squared
_NEIGHBOURS, _ALIKE = 2, 1.7  # arcs to either side, and the largest ratio of an arc's width to the median of these
_BEFOREHAND = 0.7, 0.5, 0.5  # px, and of the light: spreads of shift, contrast and brightness about those of the arc
_BENDS = 0.15 * np.arange(-1.0, 4.0)  # 1/px: of the darkness inside an edge
_BENDS_SPREAD = 0.15  # 1/px, beforehand
_LARGEST = 5.0  # of the median misfit of an arc: more does not count
_FITTED = 6.0  # parameters of an edge
_ALONG = 2.0  # samples along a normal over which what a model leaves over is alike
_LEAST = 0.5  # of the scatter expected: less is chance
_NOT_LOCATED = 0.3  # px: error of an arc whose edge is taken from its neighbours
_FEWEST = 4  # normals that are left of an arc, of which some were erased
_CONTRAST = 0.03  # of the light: a fainter jump is no edge
_NOISE_PIXELS = 40_000  # from which the noise is estimated, in every so many rows
_NOISE_ROWS = 8  # of them, at least


@dataclass(frozen=True, eq=False)
class EdgeOutline:
    """Closed outline with the error of each of its points."""

    points: Floats = field(repr=False)  # (n, 2) [px]: columns (x, y), about a pixel apart
    normals: Floats = field(repr=False)  # (n, 2): unit vectors outwards
    point_error: Floats = field(repr=False)  # (n,) [px]: along the normal, independent from point to point
    arc_error: Floats = field(repr=False)  # (n,) [px]: along the normal, shared by the points of one arc
    arc: NDArray[np.intp] = field(repr=False)  # (n,): number of the arc of each point
    edge_width: Floats = field(repr=False)  # (n,) [px]: standard deviation of the blur at each point
    located: Booleans = field(repr=False)  # (n,): false where the edge of an arc was not found
    erased: Booleans = field(repr=False)  # (n,): true where the points are a bridge over what a person erased
    alike: float = ARC  # [px]: length of the arcs


def pixel_noise(light: Floats) -> float:
    """Return the standard deviation of one pixel's noise, by second differences, most of which hold only noise."""
    light = light[:: max(1, min(light.size // _NOISE_PIXELS, len(light) // _NOISE_ROWS))]
    second = light[1:-1, 1:-1] - 0.5 * (light[1:-1, :-2] + light[1:-1, 2:])
    return max(robust_spread(second) / np.sqrt(1.5), 1e-6)


def locate_edge(
    light: Floats,
    polygon: Floats,
    noise: float,
    erased: Booleans | None = None,
    accepted: Callable[[EdgeOutline], bool] = lambda outline: True,
) -> EdgeOutline | None:
    """Locate the edge of a capsule, starting from an outline of a pixel's accuracy; None where there is none."""
    # light over that of the empty channel; polygon (p, 2) clockwise as seen in the picture; no edge is sought where
    # erased (p,)
    erased = np.zeros(len(polygon), dtype=bool) if erased is None else erased
    first = np.maximum(np.floor(polygon.min(axis=0)).astype(int) - 2 * _REACH, 0)
    last = np.ceil(polygon.max(axis=0)).astype(int) + 2 * _REACH
    part = light[first[1] : last[1], first[0] : last[0]]
    for length, smoothing in _ATTEMPTS:
        outline = _located(gaussian_filter(part, smoothing), polygon - first, noise, erased, length)
        if outline is not None and (smoothing or median(outline.edge_width) > _SHARP) and accepted(outline):
            return replace(outline, points=outline.points + first)
    return None


def _located(light: Floats, curve: Floats, noise: float, erased: Booleans, length: float) -> EdgeOutline | None:
    """Locate the edge that lies next to a curve (p, 2), by arcs of a length [px]."""
    spline = spline_filter(light, order=3, mode="mirror")
    moved = _moved(spline, curve, erased, np.array([_START_WIDTH]), 0.0, length)
    for estimated in (True, False):  # where the curve lies on the edge to a fraction of a pixel, then kept
        if moved is None:
            return None
        outline, _, bend = moved
        moved = _moved(spline, outline.points, outline.erased, outline.edge_width, None if estimated else bend, length)
    if moved is None:
        return None
    outline, arc_misfit, _ = moved
    left = scatter_left(averaged(outline.points), averaged(outline.normals), without_erased(outline))
    seen = left / scatter_expected(outline)  # noise of a pixel that would scatter the points as they do
    of_noise = np.square(max(noise, seen) * outline.arc_error)
    arc_error = np.sqrt(of_noise + _ALONG * np.maximum(np.square(arc_misfit) - of_noise, 0.0))
    of_bridges = bridge_errors(outline.points, outline.erased)
    return replace(
        outline,
        point_error=np.hypot(max(_LEAST * noise, seen) * outline.point_error, of_bridges),
        arc_error=np.hypot(np.where(outline.located, arc_error, _NOT_LOCATED), of_bridges),
    )


def averaged(values: Floats) -> Floats:
    """Return the means of three consecutive rows each; an incomplete last group is omitted."""
    count = len(values) // AVERAGED
    return np.asarray(values[: count * AVERAGED].reshape(count, AVERAGED, -1).mean(axis=1))


def thinned(points: Floats) -> Floats:
    """Return means of three consecutive points each of an outline (n, 2), on the curve through them : (n // 3, 2)."""
    # a mean of points lies within a tight corner: it is moved out by what those of the smooth curve lie within
    smooth = smooth_curve(points)
    within = smooth[AVERAGED // 2 :: AVERAGED][: len(points) // AVERAGED] - averaged(smooth)
    return np.asarray(averaged(points) + within)


def without_erased(outline: EdgeOutline) -> Booleans:
    """Return which of the means of three consecutive points hold no erased one : (m,) array."""
    return np.asarray(averaged(outline.erased.astype(float))[:, 0] == 0.0)


def scatter_expected(outline: EdgeOutline) -> float:
    """Return the standard deviation [px] of means of three points that follows from the errors of the points."""
    least, more = _SCATTER
    variance = (np.square(outline.point_error) * (least + more * np.square(outline.edge_width)))[~outline.erased]
    return float(np.sqrt(np.mean(variance) / AVERAGED))


def scatter_left(points: Floats, normals: Floats, kept: Booleans | None = None) -> float:
    """Return the standard deviation of points (n, 2) of an outline that is seen in themselves, of those kept (n,)."""
    # A curve that is smooth over five points has no fourth difference; tight corners are outliers. The noise of a pixel
    # tells less where a picture was compressed or filtered: its errors are then alike over several pixels.
    fourth = correlate1d(points, [1.0, -4.0, 6.0, -4.0, 1.0], axis=0, mode="wrap")
    across = np.sum(fourth * normals, axis=1)[... if kept is None else kept]
    # of the middle four fifths: the errors of a compressed picture differ from place to place
    return quantile(np.abs(across), 0.8) / 1.2816 / np.sqrt(70.0)  # the sum of the squared factors


def _moved(
    spline: Floats, curve: Floats, erased: Booleans, widths: Floats, bend: float | None, length: float
) -> tuple[EdgeOutline, Floats, float] | None:
    """Locate the edge in the mean of each arc and the shift of each normal : outline, misfit of the arcs, bend."""
    # the windows along the normals follow the widths of the last round, at equal distances along the curve
    whole = bridged(curve, erased)
    if whole is None:
        return None
    curve, erased = whole
    base, normals, curvature = _smoothed(curve, median(widths))
    erased = erased[KDTree(curve).query(base)[1]] if erased.any() else np.zeros(len(base), dtype=bool)
    kept = ~erased
    arcs = max(8, round(_SPACING * len(base) / length))
    width = np.interp((np.arange(arcs) + 0.5) / arcs, (np.arange(len(widths)) + 0.5) / len(widths), widths)
    window = np.clip(2.0 * width + 1.5, 3.0, _REACH)
    reach = float(np.floor(window.max()))
    samples = np.arange(-reach, reach + 1.0)  # positive inwards
    used = (np.abs(samples) <= window[:, None]).astype(float)
    profiles = sampled(spline, base, normals, samples)
    arc = np.arange(len(base)) * arcs // len(base)
    means, count = means_of_arcs(profiles[kept], arc[kept], arcs)
    enough = count >= _FEWEST
    if not enough.any():
        return None
    means[~enough], count = means[enough].mean(axis=0), np.maximum(count, 1.0)
    if bend is None:
        noise = median(mean_squares(profiles[kept], means, arc[kept], used))
        bend = _bend_of(means, samples, width, used, enough * count / noise)
    edge = locate(means, samples, Model.EDGE, np.zeros(arcs), width, used, bend)
    located = _is_located(edge, window) & enough
    if located.sum() < arcs // 2:
        return None
    place, blur = (_filled(values, located) for values in (edge.place, edge.width))
    blur = blur[arc]
    # further inside, a concave rear darkens only parts of an arc
    outer = used * (samples <= width[:, None])
    across, along = _blur_at(blur, normals)
    # the samples end nearer inside than outside: a difference in width would be taken for one in place
    wider = np.log(across)
    wider -= (np.bincount(arc, kept * wider) / count)[arc]
    explained = wider[:, None] * ((samples - place[:, None]) * edge.slope)[arc]
    shift, shift_variance = _shifts(profiles - explained, arc, means, edge.slope, outer)
    outward = 0.5 * curvature * along**2 - place[arc] - kept * shift
    outline = EdgeOutline(
        points=base + outward[:, None] * normals,
        normals=normals,
        point_error=np.sqrt(shift_variance),
        arc_error=np.sqrt((edge.place_variance / count)[arc]),
        arc=arc,
        edge_width=blur,
        located=located[arc] & kept,
        erased=erased,
        alike=length,
    )
    misfit = misfit_around(means - edge.fitted, used, edge.place_variance, _FITTED, _NEIGHBOURS)
    return outline, misfit[arc], bend


def _filled(values: Floats, located: Booleans) -> Floats:
    """Return the values of arcs (arcs,), interpolated around the curve where an arc was not located."""
    places = np.flatnonzero(located)
    return np.interp(np.arange(len(values)), places, values[places], period=len(values))


def _is_located(edge: ProfileFit, window: Floats) -> Booleans:
    """Return whether the edge of each arc was located: near the curve, dark inside, and as wide as around."""
    around = median_filter(edge.width, 2 * _NEIGHBOURS + 1, mode="wrap")
    alike = np.maximum(edge.width, around) < _ALIKE * np.minimum(edge.width, around)
    near = np.abs(edge.place) < 0.7 * window
    return np.asarray(edge.converged & alike & near & (edge.coefficients[:, 2] < -_CONTRAST))


def _bend_of(means: Floats, samples: Floats, width: Floats, used: Floats, weight: Floats) -> float:
    """Return the bend [1/px] of the darkness inside the edge that fits all arcs best; weights are inverse variances."""
    place = np.zeros(len(means))
    squares = []
    for bend in _BENDS:
        edge = locate(means, samples, Model.EDGE, place, width, used, bend)
        place, width = edge.place, edge.width  # near those of the next bend
        square = weight * np.sum(used * (means - edge.fitted) ** 2, axis=1)
        squares.append(np.minimum(square, _LARGEST * median(square)).sum() + (bend / _BENDS_SPREAD) ** 2)
    best = int(np.clip(np.argmin(squares), 1, len(_BENDS) - 2))
    before, least, after = squares[best - 1 : best + 2]
    step = _BENDS[1] - _BENDS[0]
    curved = before - 2.0 * least + after
    vertex = 0.5 * (before - after) / curved if curved > 0.0 else np.sign(before - after)
    return float(_BENDS[best] + step * np.clip(vertex, -1.0, 1.0))


def _smoothed(curve: Floats, blur: float) -> tuple[Floats, Floats, Floats]:
    """Return points at equal distance on the smoothed curve, unit normals, and curvatures, positive where convex."""
    count = max(32, round(arc_length(curve)[-1] / _SPACING))
    base = rounded(equally_spaced(curve, count), _SMOOTHING / _SPACING)
    return base, vertex_normals(base), curvatures(rounded(base, blur / _SPACING))


def _shifts(
    profiles: Floats, arc: NDArray[np.intp], means: Floats, slopes: Floats, used: Floats
) -> tuple[Floats, Floats]:
    """Return the inward shift of each profile against the mean of its arc, and its variance for noise 1."""
    # differences of brightness and contrast are fitted with the shift; in a wide blur the three are much alike: each
    # has a normal distribution beforehand, wide where a picture tells them
    held = median(mean_squares(profiles, means, arc, used)) / np.square(_BEFOREHAND)
    functions = used[:, None] * np.stack([slopes, means, np.ones_like(means)], axis=1)
    normal = np.einsum("akm,ajm->akj", functions, functions)
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)
    inverse = np.linalg.inv(normal + ridge[:, None, None] * np.eye(3) + np.diag(held))[:, 0]
    weights = np.einsum("ak,akm->am", inverse, functions)
    shift = np.sum(weights[arc] * (profiles - means[arc]), axis=1)
    return np.clip(shift, -1.5, 1.5), inverse[arc, 0]


def _blur_at(width: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return the blur across and along the edge at each point : (n,) arrays [px]."""
    # The blur is Gaussian, with standard deviations x and y along rows and columns. With X the blur along an edge of
    # curvature c, and Y that across it, half the light is left where Y + c X^2 / 2 has its median. For small c this is
    # c / 2 times the variance of X given Y = 0, which is (x y)^2 over the variance of Y. Its root is the blur along the
    # edge.
    streamwise = np.abs(normals[:, 0]) > 0.8
    crosswise = np.abs(normals[:, 1]) > 0.8
    x = median(width[streamwise]) if streamwise.any() else median(width)
    y = median(width[crosswise]) if crosswise.any() else x
    across = np.hypot(x * normals[:, 0], y * normals[:, 1])
    return across, x * y / across


# The furthest point of an outline in one direction, with its error

_WINDOWS = (15, 10, 7, 5)  # points to either side, widest first
_ORDER = 4
_MISFIT = 1.6  # of the residual's mean square over its expectation: largest that a window may have
EDGE_FLOOR = 0.03  # px: no edge is located better than that in a picture sampled at whole pixels


@dataclass(frozen=True)
class FurthestPoint:
    """Furthest point of an outline in a direction."""

    distance: float  # [px]: along the direction from the origin of the picture
    variance: float  # [px^2]: of the error of the distance
    systematic: float  # [px^2]: the part of the variance that is the same in all pictures of a capsule


def furthest_point(outline: EdgeOutline, direction: Floats, misfit: float) -> FurthestPoint:
    """Return the largest distance of an outline along a direction, without the error that all edges share."""
    # The largest of many uncertain points would lie too far out; the maximum of a quartic does not. The widest
    # neighbourhood counts in which it agrees with the points. The misfit [1/px] is the error of the edge's model over
    # the square of its width: the first term that the model lacks is quadratic.
    reach = outline.points @ direction
    trusted = np.hypot(outline.point_error, np.hypot(misfit * outline.edge_width**2, EDGE_FLOOR))
    top = int(np.argmax(correlate1d(reach, np.full(5, 0.2), mode="wrap")))
    for window in _WINDOWS:
        index = np.arange(top - window, top + window + 1) % len(reach)
        t, design = _design(window)
        error = trusted[index]
        weighted = design / error[:, None]
        inverse = np.linalg.solve(weighted.T @ weighted, weighted.T) / error
        coefficients = inverse @ reach[index]
        residual = (reach[index] - design @ coefficients) / error
        free = len(t) - _ORDER - 1
        square = float(residual @ residual)
        if square / free < _MISFIT:
            break
    powers = np.arange(_ORDER + 1)
    fine = np.linspace(-0.5, 0.5, 101)
    values = (fine[:, None] ** powers) @ coefficients
    best = int(np.argmax(values))
    excess = max(1.0, wider_by_few(free) ** 2 * square / free)
    value = fine[best] ** powers
    slope = powers * np.roll(value, 1)  # the derivative of a power is the next lower one, times its number
    bend = powers * np.roll(slope, 1)
    weights = value @ inverse
    of_arcs = np.bincount(outline.arc[index], weights * outline.arc_error[index])
    variance = excess * float(np.sum((weights * error) ** 2)) + float(np.sum(of_arcs**2))
    too_far = _too_far(excess * float(np.sum((slope @ inverse * error) ** 2)), -float(bend @ coefficients), variance)
    model = (misfit * float(outline.edge_width[top]) ** 2) ** 2 + EDGE_FLOOR**2
    return FurthestPoint(float(values[best]) - too_far, variance + model, model)


@lru_cache
def _design(window: int) -> tuple[Floats, Floats]:
    """Return the places of the points of a window, over its half, and their powers."""
    t = np.arange(-window, window + 1) / window
    return t, t[:, None] ** np.arange(_ORDER + 1)


def _too_far(slope_variance: float, bend: float, variance: float) -> float:
    """Return how much too large the maximum of a fitted curve is on average."""
    # an error of the slope moves the maximum of a curve of second derivative -bend, and raises it by half the slope's
    # square over the bend; of a flat curve no more than the standard error is taken off
    largest = float(np.sqrt(variance))
    return min(0.5 * slope_variance / bend, largest) if bend > 0.0 else largest


# The concave rear, a second dark band inside the outline, whose middle is taken for the membrane. Where none is
# distinct from that of the outer edge, the rear may be convex, or concave and not seen. Of a band that is wider than
# those of drawn pictures, the place of the membrane within it is not known: its deviation is in the error of the depth

_BREADTH = 0.3  # of half the capsule's height: largest distance from the axis at which the band is followed
_DEPTH = 0.45  # of the capsule's length: largest distance from the rear end at which it is sought
_BAND_SMOOTHING = 1.5  # px
_STRIP = 3.0  # px: breadth of the strips in which the band is located
_FEWEST_STRIPS = 4  # strips
_FULL = 0.2  # of the largest darkness along the band, that the outer third on either side has; a particle ends there
_FLOOR, _STRIP_SCATTER = 0.02, 1.0  # px: smallest and largest spread of the strips about the parabola
_BEHIND = 10  # px behind the band within which it must brighten again
_BAND_REACH = 1.7, 5, 14  # half width of the fit around the band: over its deviation, at least and at most in px
_PROMINENCE = 0.02  # of the light, at least
_SIGNIFICANCE = 6.0  # of the prominence over its noise
_CURVATURES = np.linspace(-2.4, 0.2, 14)  # over the capsule's half height: off the axis the rear is less deep
_FRONT = 1.0 - _DEPTH  # of the capsule's length: what lies further from the nose may be a concave rear
_RESOLVED = 60.0  # px: shortest capsule in which a second nose is sought; cells of 36 px show dark structures
_NOSES = np.linspace(0.4, 2.0, 5)  # over the capsule's half height: curvatures of a second nose
_FALL, _STEP = 6, 0.3  # px; of the darkness at the rim, by which the light falls where a second capsule begins
_CLEAR = 3.0  # of the band's deviation: nearer to the end of the silhouette it merges with the band of the outer edge
_OVERLAP, _FADING = 0.08, 2.5  # of the deviation: shift by the outer edge's band, and distance at which it fades
_WIDE = 3.5  # px: deviation from which on a band is wider than a line in focus; of 40 drawn ones it is 3.0 at most
_BAND_MISFIT = 0.02  # of the width of the band: how far the model's middle may be from that of the band


@dataclass(frozen=True, eq=False)
class RearBand:
    """Dark band of a concave rear, where it crosses the axis."""

    depth: float  # [px]: from the rear end of the capsule to the middle of the band on the axis
    depth_error: float  # [px]
    systematic: float  # [px^2]: the part of the error's square that is the same in all pictures of a capsule
    width: float  # [px]: standard deviation of the band
    within: float  # [px]: the part of the error that is the place of the membrane in a wide band or of a shell; else 0
    curvature: float  # [1/px]: second derivative of the depth across the axis
    breadth: float  # [px]: distance from the axis up to which it was followed


def find_rear(
    light: Floats,
    end: Floats,
    inwards: Floats,
    length: float,
    half_height: float,
    blur: float,
    noise: float,
    unsure: float = 0.0,
) -> RearBand | None:
    """Find the dark band of a concave rear, in which the place of the membrane is unsure by so many px."""
    rays, y = _rays(light, end, inwards, _DEPTH * length, half_height)
    # the band of the outer edge may be darker; behind it, the far side of a particle is bent the other way
    for behind_rim, most in ((False, math.inf), (True, 0.0)):
        start = _coarse(rays, y, _CURVATURES / half_height, noise, behind_rim=behind_rim)
        rear = None if start is None else _fine(rays, y, start, blur, noise, unsure)
        if rear is not None and rear.curvature < most:
            return rear
    return None


def shows_second_nose(
    light: Floats, nose: Floats, inwards: Floats, length: float, half_height: float, noise: float
) -> bool:
    """Return whether a dark band as of a second nose is seen inside the front half of a capsule."""
    # in a small cell, what lies in it is not distinct from a nose
    if length < _RESOLVED:
        return False
    rays, y = _rays(light, nose, inwards, _FRONT * length, half_height)
    curvatures = _NOSES / half_height
    band = _coarse(rays, y, curvatures, noise, behind_rim=True)
    return band is not None or _darkens_at_once(_stacked(rays, y, curvatures))


def _rays(light: Floats, end: Floats, inwards: Floats, depth: float, half_height: float) -> tuple[Floats, Floats]:
    """Return the light along rays (r, u) from an end inwards, a pixel apart, and their distances (r,) from the axis."""
    breadth = _BREADTH * half_height
    y = np.arange(-np.floor(breadth), np.floor(breadth) + 1.0)
    at = end[:, None, None] + np.multiply.outer(inwards, np.arange(math.ceil(depth)))[:, None]
    at = at + np.multiply.outer([-inwards[1], inwards[0]], y)[:, :, None]
    return np.asarray(map_coordinates(light, at[::-1], order=1, mode="nearest")), y


def _stacked(rays: Floats, y: Floats, curvatures: Floats) -> Floats:
    """Return the mean of the rays (r, u) along curves of some curvatures (c,) : (c, u) array."""
    bend = np.rint(0.5 * curvatures[:, None] * y**2).astype(np.int64)[:, :, None]  # by which each ray is shifted
    count, deep = rays.shape
    inward = np.clip(np.arange(deep) + bend, 0, deep - 1) + deep * np.arange(count)[:, None]
    return np.asarray(rays.take(inward).mean(axis=1))


def _darkens_at_once(profiles: Floats) -> bool:
    """Return whether the light in profiles (c, u) falls behind the rim and stays low, as where two capsules overlap."""
    rim = np.argmax(np.diff(profiles, axis=1) >= 0.0, axis=1)[:, None]
    windows = sliding_window_view(profiles, _FALL + _BEHIND + 1, axis=1)
    before, behind = windows[..., :_FALL].max(axis=-1), windows[..., _FALL:].max(axis=-1)
    step = before - behind - (behind - windows[..., -1])  # where the light falls on and on, there is none
    inside = (rim > 0) & (np.arange(step.shape[1]) >= rim)
    return bool(np.any(inside & (step > _STEP * (1.0 - np.take_along_axis(profiles, rim, axis=1)))))


def _coarse(
    rays: Floats, y: Floats, curvatures: Floats, noise: float, *, behind_rim: bool = False
) -> tuple[int, float, float] | None:
    """Return the depth of a band on the axis, its curvature, and its standard deviation, to a pixel."""
    # behind the rim, a band counts only if another one, that of the outer edge, is seen in front of it
    smooth = gaussian_filter1d(_stacked(rays, y, curvatures), _BAND_SMOOTHING, axis=1, mode="nearest")
    least = max(_PROMINENCE, _SIGNIFICANCE * noise / np.sqrt(len(y)))
    row, dip, prominence = _most_prominent(smooth, least, behind_rim)
    if row < 0:
        return None
    return dip, float(curvatures[row]), _deviation(smooth[row], dip, 0.5 * prominence)


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


def _fine(
    rays: Floats, y: Floats, start: tuple[int, float, float], blur: float, noise: float, unsure: float
) -> RearBand | None:
    """Locate the band in strips along the axis, and fit a parabola to the places."""
    middle, curvature, deviation = start
    share, least, most = _BAND_REACH
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
    shown = np.add.reduceat(centre.astype(float), first) / count
    parabola = np.stack([np.ones(strips), across, 0.5 * across**2], axis=1)
    fit = fit_without_outliers(
        parabola,
        shown + bands.place,
        bands.converged & (bands.coefficients[:, 0] < 0.0) & (np.abs(bands.place) < 0.5 * reach),
        rounds=2,
        floor=_FLOOR,
        enough=lambda kept: kept.sum() >= _FEWEST_STRIPS,
    )
    if fit is None or fit.spread > _STRIP_SCATTER:
        return None
    away = fit.coefficients @ parabola.T - shown
    nearest = np.abs(samples - away[:, None]).argmin(axis=1)
    dark = 0.5 * (means[:, 0] + means[:, -1]) - means[np.arange(strips), nearest]
    if min(dark[: strips // 3].mean(), dark[-(strips // 3) :].mean()) < _FULL * dark.max():
        return None
    expected = noise**2 * median(bands.place_variance[fit.kept] / count[fit.kept])
    free = int(fit.kept.sum()) - fit.design.shape[1]
    variance = fit.cofactor[0, 0] * max(expected, wider_by_few(free) ** 2 * fit.variance)
    depth = float(fit.coefficients[0] - 0.5 * fit.coefficients[2] * blur**2)
    if depth < _CLEAR * deviation:
        return None
    misfit = deviation * (_BAND_MISFIT + _OVERLAP * np.exp(-(depth / deviation - _CLEAR) / _FADING))
    of_band = float(np.sqrt(max(deviation**2 - blur**2 - _BAND_SMOOTHING**2, 0.0)))
    within = math.hypot(unsure, of_band if of_band > _WIDE else 0.0)
    systematic = float(misfit**2 + within**2)
    breadth = float(np.max(np.abs(across[fit.kept])))
    error = float(np.sqrt(variance + systematic))
    return RearBand(depth, error, systematic, deviation, within, float(fit.coefficients[2]), breadth)


# Integrals change in proportion to the displacement of a piece of the edge along its normal: independent errors from
# point to point, shared ones within an arc, and the misfit of the edge's model all around

_DENSE = 1024


@dataclass(frozen=True)
class SilhouetteIntegrals:
    """Integrals over a silhouette."""

    area: Quantity  # [px^2]
    perimeter: Quantity  # [px]
    volume: Quantity  # [px^3]: mean of the bodies of revolution of the two halves, a concave rear not subtracted
    stretch_ratio: Quantity  # [-]: perimeter over that of the sphere of this volume


def centroid(points: Floats) -> Floats:
    """Return the centroid of the area within a closed outline (n, 2) : (2,) array."""
    after = following(points)
    cross = points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]
    return np.asarray(cross @ (points + after) / (3.0 * np.sum(cross)))


def centroid_variance(outline: EdgeOutline, direction: Floats) -> float:
    """Return the variance of the centroid's place along a unit vector [px^2], of the noise alone."""
    # the misfit of the edge's model shifts the centroid alike in all pictures of a capsule
    lever = (outline.points - centroid(outline.points)) @ direction
    step = _steps(outline.points)
    return points_variance(outline, lever * step / abs(signed_area(outline.points)))


def integrate_silhouette(
    outline: EdgeOutline, axis: Floats, across: Floats, misfit: float, offset: float = EDGE_FLOOR
) -> SilhouetteIntegrals:
    """Return area, perimeter, volume of revolution and stretch ratio of an outline, whose points share an error."""
    y = (outline.points - axis) @ across
    step = _steps(outline.points)
    along = np.array([across[1], -across[0]])
    curve, perimeter, curvature = _smooth(outline.points)
    volume, area = _volume(curve @ along, (curve - axis) @ across), abs(signed_area(curve))
    by_edge = np.stack([step, curvature * step, np.pi * np.abs(y) * step])
    sphere = (0.75 * volume / np.pi) ** (1.0 / 3.0)
    ratio = perimeter / (2.0 * np.pi * sphere)
    by_edge = np.vstack([by_edge, ratio * (by_edge[1] / perimeter - by_edge[2] / (3.0 * volume))])
    model = np.hypot(misfit * outline.edge_width**2, offset)
    errors = [np.sqrt(points_variance(outline, weight, EDGE_FLOOR) + (weight @ model) ** 2) for weight in by_edge]
    values = (area, perimeter, volume, ratio)
    return SilhouetteIntegrals(*(Quantity(value, float(error)) for value, error in zip(values, errors, strict=True)))


def points_variance(outline: EdgeOutline, weight: Floats, floor: float = 0.0) -> float:
    """Return the variance of the weighted sum of the points' errors."""
    # the points of an arc shift against its mean: where the weights are alike, these shifts cancel
    count = np.bincount(outline.arc)
    total = np.bincount(outline.arc, weight)
    shared = total * np.hypot(outline.arc_error[np.flatnonzero(np.diff(outline.arc, prepend=-1))], floor)
    alone = (weight - (total / count)[outline.arc]) * outline.point_error
    return float(np.sum(shared**2) + np.sum(alone**2))


def _steps(points: Floats) -> Floats:
    """Return the length of the outline that each point represents : (n,) array."""
    edge = edge_lengths(points)
    return np.asarray(0.5 * (edge + np.roll(edge, 1)))


def _volume(z: Floats, y: Floats) -> float:
    """Return the mean volume of the bodies of revolution of the two halves of an outline about the axis y = 0."""
    before, after = y, np.roll(y, -1)
    mean = (before * np.abs(before) + after * np.abs(after) + (before + after) * np.abs(before + after)) / 6.0
    return 0.5 * np.pi * abs(float(np.sum(mean * (np.roll(z, -1) - z))))


def _smooth(points: Floats) -> tuple[Floats, float, Floats]:
    """Return dense points (d, 2) of the smooth curve through the points, its length, and its curvature at these."""
    speed = np.hypot(*smooth_curve(points, _DENSE, 1).T)
    (x, y), (bent_x, bent_y) = (smooth_curve(points, derivative=order).T for order in (1, 2))
    curvature = (x * bent_y - y * bent_x) / np.hypot(x, y) ** 3
    return smooth_curve(points, _DENSE), float(2.0 * np.pi * speed.mean()), np.asarray(curvature)
