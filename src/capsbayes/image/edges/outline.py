"""The outline of a capsule in a picture, to a fraction of a pixel.

A closed curve around the dark blob is moved to where the intensity along its normals jumps. The jump is located in
means over arcs of the curve (`edges.models`); the shift of each normal against the mean of its arc is fitted to their
difference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import spline_filter
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.edges.bridging import bridge_errors, bridged
from capsbayes.image.edges.fourier import smooth_curve
from capsbayes.image.edges.models import Model, ProfileFit, locate
from capsbayes.image.edges.profiles import (
    curvatures,
    mean_squares,
    means_of_arcs,
    misfit_around,
    rounded,
    sampled,
    tangents,
)
from capsbayes.image.edges.robust import median, quantile, robust_spread
from capsbayes.image.edges.small_equations import factorise, substitute
from capsbayes.profile import arc_length, equally_spaced

_SPACING = 1.25  # px between normals
ARC = 18.0  # px: length of the arcs that share one shape of the edge
_REACH = 9  # px along a normal, to either side
_SMOOTHING = 2.0  # px: of the curve on which the normals stand
_START_WIDTH = 1.5  # px
AVERAGED = 3  # points: the errors of their means are almost independent
_SCATTER = 0.75, 0.15  # variance of their mean over that of independent points: at zero width, and per width squared
_NEIGHBOURS, _ALIKE = 2, 1.7  # arcs to either side, and the largest ratio of an arc's width to the median of these
_AROUND = 2 * _NEIGHBOURS + 1  # arcs
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
    """Closed outline with the error of each of its points.

    Parameters
    ----------
    points : (n, 2) array [px]
        Columns (x, y), about a pixel apart.
    normals : (n, 2) array
        Unit vectors outwards.
    point_error : (n,) array [px]
        Standard error along the normal, independent from point to point.
    arc_error : (n,) array [px]
        Standard error along the normal that the points of one arc share.
    arc : (n,) array of int
        Number of the arc of each point.
    edge_width : (n,) array [px]
        Standard deviation of the blur at each point.
    located : (n,) array of bool
        False where the edge of an arc was not found, and is taken from its neighbours.
    erased : (n,) array of bool
        True where a person erased the edge: the points there are a bridge between those beside.
    """

    points: Floats = field(repr=False)
    normals: Floats = field(repr=False)
    point_error: Floats = field(repr=False)
    arc_error: Floats = field(repr=False)
    arc: NDArray[np.intp] = field(repr=False)
    edge_width: Floats = field(repr=False)
    located: Booleans = field(repr=False)
    erased: Booleans = field(repr=False)


def pixel_noise(light: Floats) -> float:
    """Return the standard deviation of one pixel's noise, by second differences, most of which hold only noise."""
    light = light[:: max(1, min(light.size // _NOISE_PIXELS, len(light) // _NOISE_ROWS))]
    second = light[1:-1, 1:-1] - 0.5 * (light[1:-1, :-2] + light[1:-1, 2:])
    return max(robust_spread(second) / np.sqrt(1.5), 1e-6)


def locate_edge(light: Floats, polygon: Floats, noise: float, erased: Booleans | None = None) -> EdgeOutline | None:
    """Locate the edge of a capsule, starting from an outline of a pixel's accuracy; None where there is none.

    The light (rows, columns) is over that of the empty channel, the noise the standard deviation of one pixel of it;
    the polygon (p, 2) [px] has columns (x, y) and is clockwise as seen in the picture. No edge is looked for where its
    points (p,) are erased.
    """
    erased = np.zeros(len(polygon), dtype=bool) if erased is None else erased
    first = np.maximum(np.floor(polygon.min(axis=0)).astype(int) - 2 * _REACH, 0)
    last = np.ceil(polygon.max(axis=0)).astype(int) + 2 * _REACH
    spline = spline_filter(light[first[1] : last[1], first[0] : last[0]], order=3, mode="mirror")
    moved = _moved(spline, polygon - first, erased, np.array([_START_WIDTH]), 0.0)
    for estimated in (True, False):  # where the curve lies on the edge to a fraction of a pixel, then kept
        if moved is None:
            return None
        bend = None if estimated else moved.bend
        moved = _moved(spline, moved.outline.points, moved.outline.erased, moved.outline.edge_width, bend)
    if moved is None:
        return None
    outline = moved.outline
    left = scatter_left(averaged(outline.points), averaged(outline.normals), without_erased(outline))
    seen = left / scatter_expected(outline)  # noise of a pixel that would scatter the points as they do
    of_noise = np.square(max(noise, seen) * outline.arc_error)
    arc_error = np.sqrt(of_noise + _ALONG * np.maximum(np.square(moved.arc_misfit) - of_noise, 0.0))
    of_bridges = bridge_errors(outline.points, outline.erased)
    return replace(
        outline,
        points=outline.points + first,
        point_error=np.hypot(max(_LEAST * noise, seen) * outline.point_error, of_bridges),
        arc_error=np.hypot(np.where(outline.located, arc_error, _NOT_LOCATED), of_bridges),
    )


def averaged(values: Floats) -> Floats:
    """Return the means of three consecutive rows each; an incomplete last group is omitted."""
    count = len(values) // AVERAGED
    return np.asarray(values[: count * AVERAGED].reshape(count, AVERAGED, -1).mean(axis=1))


def thinned(points: Floats) -> Floats:
    """Return means of three consecutive points each of an outline (n, 2), on the curve through them : (n // 3, 2).

    A mean of points lies within a tight corner, by a twentieth of a pixel at a radius of 10 px. It is moved out by what
    those of the smooth curve lie within.
    """
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
    """Return the standard deviation of points (n, 2) of an outline that is seen in themselves, in their unit.

    Only those that are kept (n,) count, by default all.

    The points are so far apart that their errors are almost independent. A curve that is smooth over five of them has
    no fourth difference; tight corners are outliers. The noise of a pixel tells less where a picture was compressed or
    filtered: its errors are then alike over several pixels.
    """
    fourth = _closed(points, 2)
    for _ in range(4):
        fourth = np.diff(fourth, axis=0)
    across = np.sum(fourth * normals, axis=1)[... if kept is None else kept]
    # of the middle four fifths: the errors of a compressed picture differ from place to place
    return quantile(np.abs(across), 0.8) / 1.2816 / np.sqrt(70.0)  # the sum of the squared factors


@dataclass(frozen=True, eq=False)
class _Moved:
    """Outline of one round, its errors those for noise 1.

    Parameters
    ----------
    outline : EdgeOutline
    arc_misfit : (n,) array [px]
        Error of the arc of each point that follows from what the model leaves over.
    bend : float [1/px]
        Bend of the darkness inside the edge.
    """

    outline: EdgeOutline
    arc_misfit: Floats
    bend: float


def _moved(spline: Floats, curve: Floats, erased: Booleans, widths: Floats, bend: float | None) -> _Moved | None:
    """Locate the edge in the mean of each arc, along normals on the smoothed curve, and the shift of each normal.

    The windows along the normals follow the widths of the last round, given at equal distances along the curve. The
    bend is estimated if it is None. Erased stretches of the curve are bridged first, and their normals are not used.
    """
    whole = bridged(curve, erased)
    if whole is None:
        return None
    curve, erased = whole
    base, tangent, curvature = _smoothed(curve, median(widths))
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    erased = erased[KDTree(curve).query(base)[1]] if erased.any() else np.zeros(len(base), dtype=bool)
    kept = ~erased
    arcs = max(8, round(_SPACING * len(base) / ARC))
    width = np.interp((np.arange(arcs) + 0.5) / arcs, (np.arange(len(widths)) + 0.5) / len(widths), widths)
    window = np.clip(2.0 * width + 1.5, 3.0, _REACH)
    reach = float(np.floor(window.max()))
    samples = np.arange(-reach, reach + 1.0)  # positive inwards
    used = (np.abs(samples) <= window[:, None]).astype(float)
    profiles = sampled(spline, base, normals, samples)
    arc = np.arange(len(base)) * arcs // len(base)
    means, count = means_of_arcs(profiles[kept], arc[kept], arcs)
    some = count >= _FEWEST
    if not some.any():
        return None
    means[~some], count = means[some].mean(axis=0), np.maximum(count, 1.0)
    if bend is None:
        noise = median(mean_squares(profiles[kept], means, arc[kept], used))
        bend = _bend_of(means, samples, width, used, some * count / noise)
    edge = locate(means, samples, Model.EDGE, np.zeros(arcs), width, used, bend)
    located = _is_located(edge, window) & some
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
    )
    misfit = misfit_around(means - edge.fitted, used, edge.place_variance, _FITTED, _NEIGHBOURS)
    return _Moved(outline, misfit[arc], bend)


def _filled(values: Floats, located: Booleans) -> Floats:
    """Return the values of arcs (arcs,), interpolated around the curve where an arc was not located."""
    if located.all():
        return values
    found = np.flatnonzero(located)
    return np.interp(np.arange(len(values)), found, values[found], period=len(values))


def _is_located(edge: ProfileFit, window: Floats) -> Booleans:
    """Return whether the edge of each arc was located: near the curve, dark inside, and as wide as around."""
    around = np.sort(sliding_window_view(_closed(edge.width, _NEIGHBOURS), _AROUND), axis=1)[:, _NEIGHBOURS]
    alike = np.maximum(edge.width, around) < _ALIKE * np.minimum(edge.width, around)
    near = np.abs(edge.place) < 0.7 * window
    return np.asarray(edge.converged & alike & near & (edge.coefficients[:, 2] < -_CONTRAST))


def _bend_of(means: Floats, samples: Floats, width: Floats, used: Floats, weight: Floats) -> float:
    """Return the bend of the darkness inside the edge, one for the whole outline, that fits the arcs best [1/px].

    The weights (arcs,) are the inverse variances of a sample. Where a picture hardly tells the bend, it is near zero.
    """
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


def _closed(values: Floats, count: int) -> Floats:
    """Return rows around an outline with the last of them before the first, and the first after the last."""
    return np.concatenate([values[-count:], values, values[:count]])


def _smoothed(curve: Floats, blur: float) -> tuple[Floats, Floats, Floats]:
    """Return points at equal distance on the smoothed curve, unit tangents, and curvatures, positive where convex.

    The curvature is that of the curve smoothed by the blur too, which averages it.
    """
    count = max(32, round(arc_length(curve)[-1] / _SPACING))
    base = rounded(equally_spaced(curve, count), _SMOOTHING / _SPACING)
    return base, tangents(base), curvatures(rounded(base, blur / _SPACING))


def _shifts(
    profiles: Floats, arc: NDArray[np.intp], means: Floats, slopes: Floats, used: Floats
) -> tuple[Floats, Floats]:
    """Return the inward shift of each profile against the mean of its arc, and its variance for noise 1.

    Differences of brightness and contrast from the mean are fitted together with the shift. In a wide blur the three
    are much alike: each has a normal distribution beforehand, wide where a picture tells them.
    """
    shift, variance = np.empty(len(profiles)), np.empty(len(profiles))
    held = median(mean_squares(profiles, means, arc, used)) / np.square(_BEFOREHAND)
    _shifted(profiles, arc, means, slopes, used, held, shift, variance)
    return np.clip(shift, -1.5, 1.5), variance


@njit(cache=True, nogil=True, error_model="numpy")
def _shifted(profiles, arc, means, slopes, used, held, shift, variance):  # type: ignore[no-untyped-def]
    """Fill in the coefficient of the slope by least squares in slope, mean and 1, and its variance."""
    normal, sides, row = np.empty((3, 3)), np.empty((3, 2)), np.empty(3)
    for n in range(len(profiles)):
        mean, slope, share = means[arc[n]], slopes[arc[n]], used[arc[n]]
        normal[:], sides[:] = 0.0, 0.0
        sides[0, 1] = 1.0
        for i in range(len(mean)):
            row[0], row[1], row[2] = share[i] * slope[i], share[i] * mean[i], share[i]
            for a in range(3):
                sides[a, 0] += row[a] * (profiles[n, i] - mean[i])
                for b in range(3):
                    normal[a, b] += row[a] * row[b]
        ridge = 1e-9 * (normal[0, 0] + normal[1, 1] + normal[2, 2])
        for a in range(3):
            normal[a, a] += ridge + held[a]
        factorise(normal)
        substitute(normal, sides[:, 0])
        substitute(normal, sides[:, 1])
        shift[n], variance[n] = sides[0, 0], sides[0, 1]


def _blur_at(width: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return the blur across and along the edge at each point : (n,) arrays [px].

    The blur is Gaussian, with the standard deviations x and y along the rows and columns: those across the edge where
    it faces that way. With X the blur along an edge of curvature c, and Y that across it, half the light is left where
    Y + c X^2 / 2 has its median. For small c this is c / 2 times the variance of X given Y = 0, which is (x y)^2 over
    the variance of Y. Its root is the blur along the edge.
    """
    streamwise = np.abs(normals[:, 0]) > 0.8
    crosswise = np.abs(normals[:, 1]) > 0.8
    x = median(width[streamwise]) if streamwise.any() else median(width)
    y = median(width[crosswise]) if crosswise.any() else x
    across = np.hypot(x * normals[:, 0], y * normals[:, 1])
    return across, x * y / across
