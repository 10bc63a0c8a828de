"""The likelihood of the measured lengths and of the velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.special import erfc

from capsbayes.arrays import Floats
from capsbayes.measurement import Measurement
from capsbayes.prediction import Prediction

# Formulas of arrays that broadcast: z and a are measured minus predicted L_z and L_a, zz, za and aa their covariance,
# of the measurement and of the model together; a is NaN where L_a was not measured

NUDGE = 0.5  # posterior standard deviations: what lies within them of a border leans on it
_FAR = 100.0  # beyond the smallest squared score: tails out there are less than 1e-21 of the largest

compiled = njit(cache=True, nogil=True, error_model="numpy")


def length_given_extent(z: Floats, a: Floats, zz: Floats, za: Floats, aa: Floats) -> tuple[Floats, Floats]:
    """Return the difference of L_a that is left once that of L_z is known, and its variance."""
    return a - za / zz * z, aa - za * za / zz


@np.errstate(all="ignore")
def misfits(z: Floats, a: Floats, zz: Floats, za: Floats, aa: Floats) -> tuple[Floats, Floats]:
    """Return the squared Mahalanobis distance of the lengths, and the determinant of 2 pi times their covariance."""
    rest, variance = length_given_extent(z, a, zz, za, aa)
    known = ~np.isnan(a)
    square = z * z / zz + np.where(known, rest * rest / variance, 0.0)
    volume = 2.0 * np.pi * zz * np.where(known, 2.0 * np.pi * variance, 1.0)
    first, second = np.broadcast_arrays(square, volume)
    return first, second


@np.errstate(all="ignore")
def velocity_ratios(
    z: Floats, a: Floats, zz: Floats, za: Floats, aa: Floats, ratio: Floats, zr: Floats, ar: Floats, rr: Floats
) -> tuple[Floats, Floats]:
    """Return mean and variance of v_o/U given the lengths, with whose errors in the model its own correlates."""
    rest, left = length_given_extent(z, a, zz, za, aa)
    known, shared = ~np.isnan(a), ar - za / zz * zr
    mean = ratio + zr / zz * z + np.where(known, shared / left * rest, 0.0)
    return mean, rr - zr * zr / zz - np.where(known, shared * shared / left, 0.0)


class FlowRate(NamedTuple):
    """Second source of the mean velocity, the flow rate over the area of the cross-section: U = Q / (A/l^2 l^2).

    All quantities are log-normal here, so that everything stays Gaussian in the logarithms.
    """

    offset: Floats | float  # log of Q / (A v_o) by the means: minus log(v_o/U) if both agree
    velocity: float  # variance of log v_o, infinite where the flow rate is the only source
    half_width: float  # variance of log l, zero where l is known or a dimension
    rate: float  # variance of log Q


def flow_mismatch(log_ratio: Floats, variance: Floats | float, flow: FlowRate) -> tuple[Floats, Floats]:
    """Return log of Q r / (A v_o), which is zero where both sources of U agree, and its variance."""
    return flow.offset + log_ratio, flow.velocity + 4.0 * flow.half_width + flow.rate + np.asarray(variance)


@np.errstate(divide="ignore", invalid="ignore")
def given_flow(log_ratio: Floats, variance: Floats | float, flow: FlowRate) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return the changes of log U, log l, log v_o and log(v_o/U) by the flow rate, and their variances given it."""
    (mismatch, total), variance = flow_mismatch(log_ratio, variance, flow), np.float64(1.0) * variance
    width, pull = flow.half_width, mismatch / total
    by_rate = 4.0 * width + flow.rate
    own = 1.0 / (1.0 + by_rate / (flow.velocity + variance))  # shares of the mismatch, one if v_o was not measured
    speed = 1.0 / (1.0 + (by_rate + variance) / np.float64(flow.velocity))
    changes = own * mismatch, 2.0 * width * pull, speed * mismatch, -variance * pull
    left = width * (1.0 - 4.0 * width / total), variance * (1.0 - variance / total)
    return changes, (own * by_rate, left[0], speed * (by_rate + variance), left[1])


def p_value(weights: Floats, scores: Floats) -> float:
    """Return the two-sided p-value by `scores` (n,), distances from means in sds, with `weights` (n,) of any sum."""
    far = scores**2 > np.fmin.reduce(scores**2) + _FAR
    tail = np.where(far, 0.0, weights * erfc(np.abs(scores) / np.sqrt(2.0)))
    below = np.sum(np.where(scores < 0.0, tail, 2.0 * weights - tail))
    above = np.sum(np.where(scores < 0.0, 2.0 * weights - tail, tail))
    return float(min(below, above) / weights.sum())


def p_values_of_lengths(
    weights: Floats, z: Floats, a: Floats, zz: Floats, za: Floats, aa: Floats
) -> tuple[float, float]:
    """Return the p-values of L_z, and of L_a given L_z, by the prior `weights` (n,) of shapes, of any sum."""
    scores = z / np.sqrt(zz)
    above = scores**2 - np.fmin.reduce(scores**2)
    likely = above < _FAR
    rest, variance = length_given_extent(*(values[likely] for values in (z, a, zz, za, aa)))
    given = weights[likely] * np.exp(-0.5 * above[likely]) / np.sqrt(zz[likely])
    return p_value(weights, scores), p_value(given, rest / np.sqrt(variance))


def sd_in_cells(masses: Floats) -> float:
    """Return the standard deviation of probabilities (n,) of any sum, in cells."""
    cells, total = np.arange(len(masses)), np.sum(masses)
    mean = np.sum(masses * cells) / total
    return float(np.sqrt(np.sum(masses * (cells - mean) ** 2) / total))


def feature_in_cells(masses: Floats) -> float:
    """Return the standard deviation, in cells, of a Gaussian as steep as probabilities (n, m) along their last axis."""
    # For a Gaussian the sum of squares over that of squared differences of neighbours is twice the variance; for
    # several modes it is that of the narrow ones, however far apart they are.
    return float(np.sqrt(np.sum(masses**2) / max(2.0 * np.sum(np.diff(masses, axis=1) ** 2), 1e-300)))


def resolution(weights: Floats) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return how well the cells of planes resolve probabilities (k, i, j)."""
    # Of the sum over all else along i, and along j, the `sd_in_cells` and the `feature_in_cells`; and the latter along
    # j of the plane with the largest sum.
    rows, columns = weights.sum(axis=(0, 2)), weights.sum(axis=(0, 1))
    heaviest = weights[np.argmax(weights.sum(axis=(1, 2)))]
    of_columns = sd_in_cells(columns), feature_in_cells(columns[None]), feature_in_cells(heaviest)
    return (sd_in_cells(rows), feature_in_cells(rows[None])), of_columns


def border_steps(covariance: Floats) -> Floats:
    """Return steps (2 d, d) beyond a border: half an sd along each principal axis of a covariance (d, d)."""
    if len(covariance) == 1:
        return NUDGE * np.sqrt(covariance) * [[1.0], [-1.0]]
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    angles = 0.5 * np.arctan2(2.0 * xy, xx - yy) + np.array([0.0, 0.5 * np.pi])
    x, y = np.cos(angles), np.sin(angles)
    reach = NUDGE * np.sqrt(np.maximum(x * x * xx + 2.0 * x * y * xy + y * y * yy, 0.0))
    ends = reach[:, None] * np.stack([x, y], axis=1)
    return np.stack([ends, -ends], axis=1).reshape(4, 2)


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
        """Return mean and variance of the true v_o/U given the lengths : arrays, see `velocity_ratios`."""
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

    def differences(
        self, model: ModelAtPoints, half_width: ArrayLike = 1.0
    ) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return measured minus predicted L_z and L_a [l], and their covariance : what `misfits` takes."""
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
