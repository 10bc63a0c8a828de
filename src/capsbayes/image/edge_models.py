"""Models of an edge or a dark band across it, fitted robustly to profiles of grey levels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.ndimage import correlate1d, gaussian_filter1d
from scipy.special import ndtri, stdtrit

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.least_squares import factorise, substitute

# The smooth curve through the points of an outline: its low harmonics

_KEPT = 0.1  # of the number of points: harmonics up to there; noise would lengthen and bend the curve


def smooth_curve(points: Floats, count: int | None = None, derivative: int = 0) -> Floats:
    """Return the smooth curve through an outline (n, 2), or a derivative of it, at `count` equal steps (of n)."""
    coefficients = np.fft.rfft(points, axis=0, norm="forward")[: int(_KEPT * len(points)) + 1]
    factors = (1j * np.arange(len(coefficients))[:, None]) ** derivative
    return np.fft.irfft(factors * coefficients, count or len(points), axis=0, norm="forward")


# Stretches of an outline that a person erased: which points they hold, and the smooth curve that bridges them

_ERROR = 0.25, 1.0  # of a bridge: px, and of its height over the chord, as a corner may have been erased
_BESIDE = 14  # points to either side that tell the direction of the curve at an end
_SHORTEST, _FEWEST = 6, 42  # points of a stretch that is left, and of all together


def within(points: Floats, boxes: Floats) -> Booleans:
    """Return which points (n, 2) lie in one of boxes (k, 4) of left, upper, right and lower limit : (n,) array."""
    inside = np.all((points[:, None] >= boxes[:, :2]) & (points[:, None] <= boxes[:, 2:]), axis=2)
    return np.asarray(np.any(inside, axis=1))


def bridged(curve: Floats, erased: Booleans) -> tuple[Floats, Booleans] | None:
    """Return a closed curve (n, 2) with its erased stretches bridged, and which points are; None if little is left."""
    if not erased.any():
        return curve, erased
    left = [run for run in runs(erased) if not erased[run[0]] and len(run) >= _SHORTEST]
    if sum(map(len, left)) < _FEWEST:
        return None
    pieces = []
    for run, following in zip(left, [*left[1:], left[0]], strict=True):
        bridge = _bridge(*_end(curve[run[::-1]]), *_end(curve[following]))
        pieces += [(curve[run], False), (bridge, True)]
    points = np.concatenate([piece for piece, _ in pieces])
    return points, np.concatenate([np.full(len(piece), flag) for piece, flag in pieces])


def bridge_errors(points: Floats, erased: Booleans) -> Floats:
    """Return the standard error [px] of each point (n, 2) of a bridge by the height of its bridge; zero elsewhere."""
    errors = np.zeros(len(points))
    least, share = _ERROR
    for run in runs(erased):
        if erased[run[0]]:
            chord, away = points[run[-1]] - points[run[0]], points[run] - points[run[0]]
            height = np.abs(chord[0] * away[:, 1] - chord[1] * away[:, 0]).max() / max(np.hypot(*chord), 1.0)
            errors[run] = np.hypot(least, share * height)
    return errors


def runs(erased: Booleans) -> list[Integers]:
    """Return the places of consecutive points of a closed curve that are alike, each of which may pass the last one."""
    changes = np.flatnonzero(erased != np.roll(erased, 1))
    if len(changes) == 0:
        return [np.arange(len(erased))]
    order = np.roll(np.arange(len(erased)), -changes[0])
    return list(np.split(order, changes[1:] - changes[0]))


def _end(points: Floats) -> tuple[Floats, Floats]:
    """Return the first of points of a curve, smoothed, and the unit vector from there on along the curve."""
    beside = points[:_BESIDE]
    t = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(beside, axis=0).T))])
    _, slope, place = np.polyfit(t, beside, 2)
    return place, slope / np.hypot(*slope)


def _bridge(start: Floats, back: Floats, stop: Floats, on: Floats) -> Floats:
    """Return points a pixel apart from `start` to `stop`, where the curve leads back and on."""
    chord = float(np.hypot(*(stop - start)))
    turn = float(np.arccos(np.clip(-back @ on, -1.0, 1.0)))
    handle = chord / (3.0 * np.cos(0.25 * turn) ** 2)  # of a cubic as near as can be to an arc of a circle
    corners = np.array([start, start - handle * back, stop - handle * on, stop])
    t = np.linspace(0.0, 1.0, max(3, round(1.2 * chord)))[1:-1, None]
    shares = np.hstack([(1.0 - t) ** 3, 3.0 * t * (1.0 - t) ** 2, 3.0 * t**2 * (1.0 - t), t**3])
    return np.asarray(shares @ corners)


# Place and width of a model are wanted; its other parameters enter linearly and are eliminated in each Gauss-Newton
# step by variable projection with the Jacobian of Kaufman 1975, BIT 15, 49 (doi 10.1007/BF01932995)

_ITERATIONS = 12
_TOLERANCE, _OF_SHARP = 2e-3, 0.05  # px; the place of an edge that no sample lies on is known to no better
_NARROWEST, _WIDEST = 0.3, 12.0  # px
_LONGEST = 1.0, 0.4  # steps of the place [px] and of the logarithm of the width
_STRAIGHT = 1e-4  # 1/px: a smaller bend is none
_RIDGE = 1e-10  # two functions may become alike as the width grows


class Model(IntEnum):
    """Model of a profile; t is the distance from the place, and the blur is Gaussian with the width."""

    EDGE = 0  # a jump between two straight lines, blurred: 1, the line outside, the jump, the line inside
    LINE = 1  # a Gaussian between two levels: the Gaussian, 1, the step
    BAND = 2  # a Gaussian on a parabola: the Gaussian, 1, t, t^2


_FUNCTIONS = {Model.EDGE: 4, Model.LINE: 3, Model.BAND: 4}


class ProfileFit(NamedTuple):
    """Model fitted to each of n profiles."""

    place: Floats  # (n,): in the unit of the samples' positions
    width: Floats  # (n,): in the unit of the samples' positions
    place_variance: Floats  # (n,): variance of the place where each sample has noise of variance 1
    coefficients: Floats  # (n, k): coefficients of the model's k functions
    fitted: Floats  # (n, m): the model at the samples that are used, 0 at the others
    slope: Floats  # (n, m): its derivative with respect to the place
    converged: Booleans  # (n,)


def locate(
    profiles: Floats, samples: Floats, model: Model, place: Floats, width: Floats, used: Floats, bend: float = 0.0
) -> ProfileFit:
    """Fit a model to each profile (n, m) where it is `used`, from guesses of place and width (n,)."""
    # the bend of an edge is the inverse of the depth at which the darkness inside falls to 1/e, 0 for a straight line
    count = len(profiles)
    fitted, slope = np.empty(profiles.shape), np.empty(profiles.shape)
    coefficients, converged = np.empty((count, _FUNCTIONS[model])), np.empty(count, dtype=np.bool_)
    begun = place.astype(np.float64), width.astype(np.float64)
    fit = ProfileFit(*begun, np.empty(count), coefficients, fitted, slope, converged)
    profiles, samples, used = (np.ascontiguousarray(each, dtype=np.float64) for each in (profiles, samples, used))
    _locate(profiles, samples, used, int(model), float(bend), *fit)
    return fit


@njit(cache=True, nogil=True, error_model="numpy")
def _locate(  # type: ignore[no-untyped-def]
    profiles, samples, used, model, bend, place, width, variance, coefficients, fitted, slope, converged
):
    m, k = len(samples), coefficients.shape[1]
    functions, by_place, by_width = np.empty((m, k)), np.empty((m, k)), np.empty((m, k))
    jacobian, step, normal = np.empty((m, 2)), np.empty(2), np.empty((2, 2))
    for n in range(len(profiles)):
        converged[n] = False
        for iteration in range(_ITERATIONS + 1):
            _evaluated(model, bend, samples, used[n], place[n], width[n], functions, by_place, by_width)
            _projected(
                profiles[n], used[n], functions, by_place, by_width, coefficients[n], fitted[n], slope[n], jacobian
            )
            _step(profiles[n], used[n], fitted[n], jacobian, normal, step)
            if converged[n] or iteration == _ITERATIONS:  # fit, slope and normal matrix belong to the last place
                break
            place[n] += min(max(step[0], -_LONGEST[0]), _LONGEST[0])
            width[n] *= math.exp(min(max(step[1], -_LONGEST[1]), _LONGEST[1]))
            width[n] = min(max(width[n], _NARROWEST), _WIDEST)
            converged[n] = abs(step[0]) <= (_OF_SHARP if width[n] == _NARROWEST else _TOLERANCE)
        variance[n] = normal[1, 1] / (normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluated(  # type: ignore[no-untyped-def]
    model, bend, samples, used, place, width, functions, by_place, by_width
):
    """Fill in the functions (m, k) and their derivatives with respect to the place and the logarithm of the width."""
    for i in range(len(samples)):
        if used[i] == 0.0:
            functions[i], by_place[i], by_width[i] = 0.0, 0.0, 0.0
            continue
        t = samples[i] - place
        u = t / width
        bell = math.exp(-0.5 * u * u)
        f, p, w = functions[i], by_place[i], by_width[i]
        if model == 0:
            density, above = bell / math.sqrt(2.0 * math.pi), 0.5 * math.erfc(-u / math.sqrt(2.0))
            ramp = width * (u * above + density)
            f[0], f[1], f[2], f[3] = 1.0, t - ramp, above, ramp
            p[0], p[1], p[2], p[3] = 0.0, above - 1.0, -density / width, -above
            w[0], w[1], w[2], w[3] = 0.0, -width * density, -u * density, width * density
            if abs(bend) > _STRAIGHT:  # (jump - blurred exponential) / bend, whose limit for no bend is the ramp
                blurred = bend * width
                fall = math.exp(0.5 * blurred * blurred - bend * t) * 0.5 * math.erfc((blurred - u) / math.sqrt(2.0))
                f[3] = (above - fall) / bend
                p[3] = -fall
                w[3] = width * density - blurred * width * fall
        elif model == 1:
            density, above = bell / math.sqrt(2.0 * math.pi), 0.5 * math.erfc(-u / math.sqrt(2.0))
            f[0], f[1], f[2] = bell, 1.0, above
            p[0], p[1], p[2] = u * bell / width, 0.0, -density / width
            w[0], w[1], w[2] = u * u * bell, 0.0, -u * density
        else:
            f[0], f[1], f[2], f[3] = bell, 1.0, t, t * t
            p[0], p[1], p[2], p[3] = u * bell / width, 0.0, -1.0, -2.0 * t
            w[0], w[1], w[2], w[3] = u * u * bell, 0.0, 0.0, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _projected(  # type: ignore[no-untyped-def]
    profile, used, functions, by_place, by_width, coefficients, fitted, slope, jacobian
):
    """Fill in the best coefficients, the fit, its slope, and the Jacobian (m, 2) with the coefficients eliminated."""
    m, k = functions.shape
    matrix, sides = np.zeros((k, k)), np.zeros((k, 3))  # of the profile, and of the derivatives by place and width
    for i in range(m):
        if used[i] != 0.0:
            for a in range(k):
                sides[a, 0] += functions[i, a] * profile[i]
                for b in range(a + 1):
                    matrix[a, b] += functions[i, a] * functions[i, b]
    for a in range(k):
        matrix[a, a] = matrix[a, a] * (1.0 + 1e-12) + _RIDGE
        for b in range(a):
            matrix[b, a] = matrix[a, b]
    factorise(matrix)
    substitute(matrix, sides[:, 0])
    for a in range(k):  # numba takes seconds to compile an assignment of arrays
        coefficients[a] = sides[a, 0]
    for i in range(m):
        total, along_place, along_width = 0.0, 0.0, 0.0
        for a in range(k):
            total += coefficients[a] * functions[i, a]
            along_place += coefficients[a] * by_place[i, a]
            along_width += coefficients[a] * by_width[i, a]
        fitted[i], slope[i] = total, along_place
        jacobian[i, 0], jacobian[i, 1] = along_place * used[i], along_width * used[i]
        for a in range(k):
            sides[a, 1] += jacobian[i, 0] * functions[i, a]
            sides[a, 2] += jacobian[i, 1] * functions[i, a]
    substitute(matrix, sides[:, 1])
    substitute(matrix, sides[:, 2])
    for i in range(m):
        if used[i] != 0.0:
            for a in range(k):
                jacobian[i, 0] -= functions[i, a] * sides[a, 1]
                jacobian[i, 1] -= functions[i, a] * sides[a, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _step(profile, used, fitted, jacobian, normal, step):  # type: ignore[no-untyped-def]
    """Fill in the normal matrix (2, 2) and the Gauss-Newton step (2,)."""
    normal[:], step[:] = 0.0, 0.0
    for i in range(len(profile)):
        left = used[i] * (profile[i] - fitted[i])
        for a in range(2):
            step[a] += jacobian[i, a] * left
            for b in range(2):
                normal[a, b] += jacobian[i, a] * jacobian[i, b]
    for a in range(2):
        normal[a, a] = normal[a, a] * (1.0 + 1e-6) + 1e-12
    determinant = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[1, 0]
    by_place = (normal[1, 1] * step[0] - normal[0, 1] * step[1]) / determinant
    step[1] = (normal[0, 0] * step[1] - normal[1, 0] * step[0]) / determinant
    step[0] = by_place


# Profiles along the normals of a closed curve, and their arcs


@njit(cache=True, nogil=True, error_model="numpy")
def sampled(spline, points, normals, samples):  # type: ignore[no-untyped-def]
    """Return a picture at distances (m,) inwards from points (n, 2) along their normals outwards : (n, m) array."""
    # by the coefficients of its cubic spline, mirrored at its borders, beyond which it stays as it is there
    rows, columns = spline.shape
    values = np.empty((len(points), len(samples)))
    by_row, by_column = np.empty(4), np.empty(4)
    for n in range(len(points)):
        for i in range(len(samples)):
            row = min(max(points[n, 1] - samples[i] * normals[n, 1], 0.0), rows - 1.0)
            column = min(max(points[n, 0] - samples[i] * normals[n, 0], 0.0), columns - 1.0)
            upper, left = int(row), int(column)
            _weights(row - upper, by_row)
            _weights(column - left, by_column)
            total = 0.0
            for a in range(4):
                r = _mirrored(upper + a - 1, rows)
                for b in range(4):
                    total += by_row[a] * by_column[b] * spline[r, _mirrored(left + b - 1, columns)]
            values[n, i] = total
    return values


@njit(cache=True, nogil=True, error_model="numpy")
def _weights(t, weights):  # type: ignore[no-untyped-def]
    """Fill in the weights (4,) of the coefficients around a place, a distance t in (0, 1) behind the second."""
    weights[0] = (1.0 - t) ** 3 / 6.0
    weights[1] = (3.0 * t - 6.0) * t * t / 6.0 + 2.0 / 3.0
    weights[2] = ((3.0 - 3.0 * t) * t + 3.0) * t / 6.0 + 1.0 / 6.0
    weights[3] = t**3 / 6.0


@njit(cache=True, nogil=True, error_model="numpy")
def _mirrored(index, count):  # type: ignore[no-untyped-def]
    return abs(index) if index < count else 2 * (count - 1) - index


def means_of_arcs(profiles: Floats, arc: Integers, arcs: int) -> tuple[Floats, Floats]:
    """Return the mean of the profiles (n, m) of each arc : (arcs, m) array, and their numbers : (arcs,) array."""
    count, samples = np.bincount(arc, minlength=arcs).astype(np.float64), profiles.shape[1]
    place = arc[:, None] * samples + np.arange(samples)
    sums = np.bincount(place.ravel(), profiles.ravel(), arcs * samples).reshape(arcs, samples)
    return sums / np.maximum(count, 1.0)[:, None], count


def mean_squares(profiles: Floats, means: Floats, arc: Integers, used: Floats) -> Floats:
    """Return the mean square of the difference of profiles from their arc's where it is used (arcs, m) : (n,) array."""
    return np.asarray(np.sum(used[arc] * (profiles - means[arc]) ** 2, axis=1) / np.sum(used, axis=1)[arc])


def misfit_around(left: Floats, used: Floats, place_variance: Floats, fitted: float, neighbours: int) -> Floats:
    """Return the error of the place of each arc that follows from what the model leaves over : (arcs,) array."""
    # few degrees of freedom are left, as so many parameters are fitted: those of the neighbours are added
    squares, free = np.sum(used * left**2, axis=1), np.maximum(np.sum(used, axis=1) - fitted, 0.0)
    squares, free = correlate1d(np.stack([squares, free]), np.ones(2 * neighbours + 1), mode="wrap")
    return np.asarray(np.sqrt(squares / np.maximum(free, 1.0) * place_variance))


def curvatures(curve: Floats) -> Floats:
    """Return the curvature at points (n, 2) at equal distances of a clockwise curve, positive where it is convex."""
    before, after = np.roll(curve, 1, axis=0), np.roll(curve, -1, axis=0)
    (x, y), (bent_x, bent_y) = 0.5 * (after - before).T, (after - 2.0 * curve + before).T
    return np.asarray((x * bent_y - y * bent_x) / np.hypot(x, y) ** 3)


def rounded(curve: Floats, deviation: float) -> Floats:
    """Return a closed curve (n, 2) smoothed by a Gaussian of a standard deviation in points."""
    return np.asarray(gaussian_filter1d(curve, deviation, axis=0, mode="wrap"))


# Straight lines and parabolas by least squares, without the points that lie off them

_OUTLIER = 4.0  # robust standard deviations


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Least-squares fit to the points that were kept."""

    coefficients: Floats  # (k,)
    kept: Booleans  # (n,)
    spread: float  # robust standard deviation of the residuals, before the last outliers were removed
    variance: float  # variance of the residuals of the points that were kept
    design: Floats  # (n, k): rows of the points that were kept

    @property
    def cofactor(self) -> Floats:
        """Covariance of the coefficients over the variance of a point : (k, k) array."""
        return np.asarray(np.linalg.inv(self.design.T @ self.design))


def median(values: Floats) -> float:
    """Return the median of an array without NaN, NaN if it is empty."""
    return quantile(values, 0.5)


def quantile(values: Floats, share: float) -> float:
    """Return the value below which a share of an array lies, linear between two; np.quantile takes longer."""
    ordered = values.flatten()
    if not len(ordered):
        return np.nan
    place = share * (len(ordered) - 1)
    below = int(place)
    ordered.partition(below)  # by one place: by two, it takes five times as long for a picture
    low, high = ordered[below], ordered[min(below + 1, len(ordered) - 1) :].min()
    return float(low + (place - below) * (high - low))


@lru_cache
def wider_by_few(free: int) -> float:
    """Return Student's 95 % interval over that of a known variance: a scatter seen in few values is rough."""
    return float(stdtrit(max(free, 1), 0.975) / ndtri(0.975))


def robust_spread(residuals: Floats) -> float:
    """Return the standard deviation of normal errors that have this median absolute value."""
    return median(np.abs(residuals)) / 0.6745


def fit_without_outliers(
    design: Floats, values: Floats, kept: Booleans, *, rounds: int, floor: float, enough: Callable[[Booleans], bool]
) -> RobustFit | None:
    """Fit design (n, k) @ coefficients again and again without outliers; None if the points left are not `enough`."""
    for _ in range(rounds):
        if not enough(kept):
            return None
        coefficients = np.asarray(np.linalg.lstsq(design[kept], values[kept], rcond=None)[0], dtype=np.float64)
        residuals = values - design @ coefficients
        spread = max(robust_spread(residuals[kept]), floor)
        before, kept = kept, kept & (np.abs(residuals) < _OUTLIER * spread)
        if np.array_equal(kept, before):  # the next fit is the same
            break
    if not enough(kept):
        return None
    used = design[kept]
    variance = np.sum(residuals[kept] ** 2) / max(len(used) - design.shape[1], 1)
    return RobustFit(coefficients, kept, spread, float(variance), used)
