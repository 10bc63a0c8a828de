"""The likelihood of the measured lengths and of the velocity."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.measurement import Measurement
from capsbayes.prediction import Prediction

# Compiled formulas of inference.
#
# The lengths (L_z, L_a) are Gaussian: L_z with the variance ``zz``, and L_a given L_z. L_a is NaN where it is missing

NUDGE = 0.5  # posterior standard deviations: what lies within them of a border leans on it
_FAR = 100.0  # beyond the smallest squared score: tails out there are less than 1e-21 of the largest

compiled = njit(cache=True, nogil=True, error_model="numpy")


@compiled
def length_given_extent(z, a, zz, za, aa):  # type: ignore[no-untyped-def]
    """Return the difference of L_a that is left once that of L_z is known, and its variance."""
    return a - za / zz * z, aa - za * za / zz


@compiled
def misfit(z: float, a: float, zz: float, za: float, aa: float) -> tuple[float, float]:
    """Return the squared Mahalanobis distance of the lengths and the determinant of 2 pi times their covariance.

    Parameters
    ----------
    z, a : float
        Measured minus predicted L_z and L_a; ``a`` is NaN where L_a was not measured.
    zz, za, aa : float
        Covariance, of the measurement and of the model together.
    """
    square, volume = z * z / zz, 2.0 * np.pi * zz
    if not np.isnan(a):
        rest, variance = length_given_extent(z, a, zz, za, aa)
        square += rest * rest / variance
        volume *= 2.0 * np.pi * variance
    return square, volume


@compiled
def velocity_ratio(
    z: float, a: float, zz: float, za: float, aa: float, ratio: float, zr: float, ar: float, rr: float
) -> tuple[float, float]:
    """Return mean and variance of v_o/U given the lengths.

    The model's errors in the lengths and in v_o/U are correlated: what the lengths reveal of the former corrects the
    latter.

    Parameters
    ----------
    z, a, zz, za, aa : float
        As of `misfit`.
    ratio : float
        v_o/U as predicted.
    zr, ar, rr : float
        Covariance of its error with those of L_z and L_a, and its variance.
    """
    mean, variance = ratio + zr / zz * z, rr - zr * zr / zz
    if not np.isnan(a):
        rest, left = length_given_extent(z, a, zz, za, aa)
        shared = ar - za / zz * zr
        mean += shared / left * rest
        variance -= shared * shared / left
    return mean, variance


class Flow(NamedTuple):
    """Second source of the mean velocity, the flow rate over the area of the cross-section: U = Q / (A/l^2 l^2)."""

    # All quantities are log-normal here, so that everything stays Gaussian in the logarithms.

    offset: float  # log of Q / (A v_o) by the means: minus log(v_o/U) if both agree; NaN without a flow rate
    velocity: float  # variance of log v_o, infinite where the flow rate is the only source
    half_width: float  # variance of log l, zero where l is known or a dimension
    rate: float  # variance of log Q


@compiled
def flow_mismatch(log_ratio, variance, flow):  # type: ignore[no-untyped-def]
    """Return log of Q r / (A v_o), which is zero where both sources of U agree, and its variance.

    Parameters
    ----------
    log_ratio, variance : float or array
        Log of r = v_o/U of the model, and its variance.
    flow : Flow
    """
    return flow.offset + log_ratio, flow.velocity + 4.0 * flow.half_width + flow.rate + variance


@compiled
def given_flow(log_ratio, variance, flow):  # type: ignore[no-untyped-def]
    """Return the changes of log U, log l, log v_o and log(v_o/U) by the flow rate, and their variances given it.

    Parameters
    ----------
    log_ratio, variance, flow
        As of `flow_mismatch`; log U without the flow rate is log v_o - log_ratio.

    Returns
    -------
    changes, variances : tuples of four
    """
    mismatch, total = flow_mismatch(log_ratio, variance, flow)
    width, pull = flow.half_width, mismatch / total
    by_rate = 4.0 * width + flow.rate
    own = 1.0 / (1.0 + by_rate / (flow.velocity + variance))  # shares of the mismatch, one if v_o was not measured
    speed = 1.0 / (1.0 + (by_rate + variance) / flow.velocity)
    changes = own * mismatch, 2.0 * width * pull, speed * mismatch, -variance * pull
    return changes, (
        own * by_rate,
        width * (1.0 - 4.0 * width / total),
        speed * (by_rate + variance),
        variance * (1.0 - variance / total),
    )


@compiled
def p_value(weights: Floats, scores: Floats) -> float:
    """Return the two-sided p-value of a number whose distribution is a mixture of normal ones.

    Parameters
    ----------
    weights : (n,) array
        Of any sum.
    scores : (n,) array
        Distance from each mean in standard deviations of each.
    """
    nearest = np.inf
    for k in range(len(scores)):
        nearest = min(nearest, scores[k] ** 2)
    below, above = 0.0, 0.0
    for k in range(len(scores)):
        tail = 0.0
        if not scores[k] ** 2 > nearest + _FAR:  # nor if it is not a number
            tail = weights[k] * math.erfc(abs(scores[k]) / math.sqrt(2.0))
        below += tail if scores[k] < 0.0 else 2.0 * weights[k] - tail
        above += 2.0 * weights[k] - tail if scores[k] < 0.0 else tail
    return min(below, above) / weights.sum()


@compiled
def p_values_of_lengths(
    weights: Floats, z: Floats, a: Floats, zz: Floats, za: Floats, aa: Floats
) -> tuple[float, float]:
    """Return the p-values of L_z, predicted from the prior, and of L_a, predicted from L_z and the prior.

    Parameters
    ----------
    weights : (n,) array
        Prior probabilities of shapes, of any sum.
    z, a, zz, za, aa : (n,) arrays
        As of `misfit`.
    """
    scores, likely = np.empty(len(z)), np.empty(len(z))
    nearest = np.inf
    for k in range(len(z)):
        scores[k] = z[k] / np.sqrt(zz[k])
        nearest = min(nearest, scores[k] ** 2)
    of_extent, count = p_value(weights, scores), 0
    for k in range(len(z)):
        if scores[k] ** 2 < nearest + _FAR:
            likely[count] = weights[k] * np.exp(0.5 * (nearest - scores[k] ** 2)) / np.sqrt(zz[k])
            rest, variance = length_given_extent(z[k], a[k], zz[k], za[k], aa[k])
            scores[count] = rest / np.sqrt(variance)
            count += 1
    return of_extent, p_value(likely[:count], scores[:count])


@compiled
def _fill_misfits(z, a, zz, za, aa, square, volume):  # type: ignore[no-untyped-def]
    for k in range(len(z)):
        square[k], volume[k] = misfit(z[k], a[k], zz[k], za[k], aa[k])


@compiled
def _fill_velocity_ratios(z, a, zz, za, aa, ratio, zr, ar, rr, mean, variance):  # type: ignore[no-untyped-def]
    for k in range(len(z)):
        numbers = ratio[k], zr[k], ar[k], rr[k]
        mean[k], variance[k] = velocity_ratio(z[k], a[k], zz[k], za[k], aa[k], *numbers)


def misfits(*arguments: ArrayLike) -> tuple[Floats, Floats]:
    """Return `misfit` of arrays that broadcast."""
    return _filled(_fill_misfits, arguments)


def velocity_ratios(*arguments: ArrayLike) -> tuple[Floats, Floats]:
    """Return `velocity_ratio` of arrays that broadcast."""
    return _filled(_fill_velocity_ratios, arguments)


def _filled(fill: Callable[..., None], arguments: Sequence[ArrayLike]) -> tuple[Floats, Floats]:
    arrays = np.broadcast_arrays(*arguments)
    first, second = np.empty(arrays[0].size), np.empty(arrays[0].size)
    fill(*(np.ascontiguousarray(array, dtype=np.float64).ravel() for array in arrays), first, second)
    return first.reshape(arrays[0].shape), second.reshape(arrays[0].shape)


@compiled
def sd_in_cells(masses: Floats) -> float:
    """Return the standard deviation of probabilities (n,) of any sum, in cells."""
    total, mean, square = 0.0, 0.0, 0.0
    for k in range(len(masses)):
        total += masses[k]
        mean += masses[k] * k
    mean /= total
    for k in range(len(masses)):
        square += masses[k] * (k - mean) ** 2
    return np.sqrt(square / total)


@compiled
def feature_in_cells(masses: Floats) -> float:
    """Return the standard deviation, in cells, of a Gaussian as steep as probabilities (n, m) along their last axis.

    For a Gaussian the sum of squares over the sum of squared differences of neighbours is twice the variance; for
    several modes it is that of the narrow ones, however far apart they are.
    """
    squares, steps = 0.0, 0.0
    for i in range(masses.shape[0]):
        for j in range(masses.shape[1]):
            squares += masses[i, j] ** 2
            if j:
                steps += (masses[i, j] - masses[i, j - 1]) ** 2
    return np.sqrt(squares / max(2.0 * steps, 1e-300))


@compiled
def resolution(weights: Floats) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return how well the cells of planes resolve probabilities (k, i, j).

    Of the sum over all else along i, and along j, the `sd_in_cells` and the `feature_in_cells`; and the latter along j
    of the plane with the largest sum.
    """
    rows, columns = np.zeros((1, weights.shape[1])), np.zeros((1, weights.shape[2]))
    heaviest, largest = 0, -1.0
    for k in range(weights.shape[0]):
        total = 0.0
        for i in range(weights.shape[1]):
            for j in range(weights.shape[2]):
                rows[0, i] += weights[k, i, j]
                columns[0, j] += weights[k, i, j]
                total += weights[k, i, j]
        if total > largest:
            heaviest, largest = k, total
    of_rows = sd_in_cells(rows[0]), feature_in_cells(rows)
    return of_rows, (sd_in_cells(columns[0]), feature_in_cells(columns), feature_in_cells(weights[heaviest]))


@compiled
def border_steps(covariance: Floats) -> Floats:
    """Return the steps that take what leans on a border beyond it : (2 d, d) array.

    Half a standard deviation either way along each principal axis of a covariance (d, d) of one or two quantities.
    """
    steps = np.zeros((2 * len(covariance), len(covariance)))
    xx, xy, yy = covariance[0, 0], covariance[0, -1], covariance[-1, -1]
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) if len(covariance) == 2 else 0.0
    for k in range(len(covariance)):
        x, y = np.cos(angle + 0.5 * np.pi * k), np.sin(angle + 0.5 * np.pi * k)
        reach = NUDGE * np.sqrt(max(x * x * xx + 2.0 * x * y * xy + y * y * yy, 0.0))
        steps[2 * k, 0], steps[2 * k + 1, 0] = reach * x, -reach * x
        if len(covariance) == 2:
            steps[2 * k, 1], steps[2 * k + 1, 1] = reach * y, -reach * y
    return steps


# Likelihood of the lengths: Gaussian, with the measurement's covariance plus the model's own at that point.
#
# The model's error varies over the (Ca, a/l) plane, so the determinant of the covariance is part of the likelihood. L_a
# may be missing


class ModelAtPoints(NamedTuple):
    """Predictions of a model as the likelihood reads them, of any batch shape."""

    extent: Floats  # L_z [l]
    length: Floats  # L_a [l]
    velocity_ratio: Floats  # v_o/U
    zz: Floats  # covariance of the model's own error in L_z and L_a
    za: Floats
    aa: Floats
    zr: Floats  # the same with v_o/U
    ar: Floats
    rr: Floats
    stretch_ratio: Floats  # Lambda
    outline: Floats | None = None  # log density of the measured outline
    log_area: Floats | None = None  # of the cross-section over that of the plain one, given a flow rate

    def at_unit_velocity(self) -> ModelAtPoints:
        """Return the same with v_o/U known to be one, as where mu U is given in place of viscosity and velocity."""
        none = 0.0 * self.velocity_ratio  # NaN where the model has no answer
        return self._replace(velocity_ratio=none + 1.0, zr=none, ar=none, rr=none)

    @classmethod
    def of(cls, prediction: Prediction, *, error_scale: float = 1.0) -> ModelAtPoints:
        """Return the numbers of a prediction; `error_scale` multiplies the standard errors of the model."""
        c = prediction.covariance if error_scale == 1.0 else prediction.covariance * error_scale**2
        ratio, stretch = prediction.velocity_ratio, prediction.stretch_ratio
        of_error = (c[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))
        return cls(*(prediction.axial_extent, prediction.axial_length, ratio, *of_error, stretch))

    def rescaled(self, factor: float) -> ModelAtPoints:
        """Return the same with the standard errors of the model times a factor."""
        own = {name: factor**2 * getattr(self, name) for name in ("zz", "za", "aa", "zr", "ar", "rr")}
        return self._replace(**own)

    def taken(self, index: Any) -> ModelAtPoints:
        """Return some of the points, by a numpy index."""
        return ModelAtPoints(*(values if values is None else values[index] for values in self))  # type: ignore[arg-type]

    def joined(self, other: ModelAtPoints) -> ModelAtPoints:
        """Return these points followed by others, both with the density of an outline or neither."""
        pairs = zip(self, other, strict=True)
        return ModelAtPoints(*(mine if mine is None else np.concatenate([mine, rest]) for mine, rest in pairs))  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class LengthsLikelihood:
    """Density of the measured lengths given the model."""

    extent: float  # L_z
    length: float | None  # L_a
    zz: float  # covariance of the measurement
    za: float
    aa: float
    over_half_width: bool  # else in metres

    @classmethod
    def of(cls, measurement: Measurement) -> LengthsLikelihood:
        """Return the likelihood of one measurement."""
        c = measurement.covariance
        both = len(c) == 2
        return cls(
            measurement.axial_extent,
            measurement.axial_length,
            float(c[0, 0]),
            float(c[0, 1]) if both else 0.0,
            float(c[1, 1]) if both else 0.0,
            measurement.over_half_width,
        )

    def log_density(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> Floats:
        """Return the log density of the measured lengths."""
        square, volume = misfits(*self.differences(model, half_width))
        log_density = -0.5 * (square + np.log(volume))
        if self.over_half_width:
            return log_density
        return log_density - (1 if self.length is None else 2) * np.log(half_width)

    def distance(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> Floats:
        """Return the Mahalanobis distance of the lengths from the predicted ones : array."""
        return np.sqrt(misfits(*self.differences(model, half_width))[0])

    def velocity_ratio(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> tuple[Floats, Floats]:
        """Return mean and variance of the true v_o/U given the lengths : arrays, see `kernel.velocity_ratio`."""
        differences = self.differences(model, half_width)
        return velocity_ratios(*differences, model.velocity_ratio, model.zr, model.ar, model.rr)

    def with_half_width(self, centre: float, error: float) -> LengthsLikelihood:
        """Return the same lengths over l with the error of l in their covariance: an approximation."""
        if self.over_half_width:
            return self
        z, a = self.extent / centre, None if self.length is None else self.length / centre
        share, other = (error / centre) ** 2, a or 0.0
        zz, za, aa = (value / centre**2 for value in (self.zz, self.za, self.aa))
        return LengthsLikelihood(z, a, zz + share * z * z, za + share * z * other, aa + share * other * other, True)

    def differences(self, model: ModelAtPoints, half_width: ArrayLike = 1.0) -> tuple[Floats, ...]:
        """Return measured minus predicted L_z and L_a [l], and their covariance : what `kernel.misfit` takes."""
        scale = 1.0 if self.over_half_width else np.asarray(half_width)
        square = scale * scale
        length = np.nan if self.length is None else self.length
        return (
            self.extent / scale - model.extent,
            length / scale - model.length,
            model.zz + self.zz / square,
            model.za + self.za / square,
            model.aa + self.aa / square,
        )
