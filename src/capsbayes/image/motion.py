"""Velocity of a capsule from its places in the frames, and changes of velocity and lengths along the channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.quantity import Quantity

LONGEST_SMEAR = 3.0  # px in one exposure, up to which the intervals of pictures were counted
_DISTINCT = 10.0  # standard errors of a step
_WHOLE = 0.25  # of a step: how far one may be from a whole multiple of it
_MOVING, _STILL = 0.9, 0.1  # quantile of the steps that is one of two frames that differ; of it: one of a copy
_COPIES = 0.18  # of the steps: more are no chance
_SIGNIFICANT = 3.0  # standard errors
_NEGLIGIBLE = 0.01  # of the quantity itself: a smaller change is added to the error, not a reason to refuse


def smeared(exposure: Quantity | None, velocity: float, pixel_size: float) -> bool:
    """Return whether a capsule at a velocity [m/s] moves by too many pixels, of a size [m], during the exposure [s]."""
    return exposure is not None and exposure.mean * abs(velocity) > LONGEST_SMEAR * pixel_size


@dataclass(frozen=True)
class Drift:
    """Change of a quantity from the first to the last frame, by a straight line through its values."""

    change: float  # over the quantity's mean
    error: float

    @property
    def significant(self) -> bool:
        """True if the change is more than three of its standard errors."""
        return abs(self.change) / self.error > _SIGNIFICANT

    @property
    def unsteady(self) -> bool:
        """True if the change is significant and more than a hundredth."""
        return self.significant and abs(self.change) > _NEGLIGIBLE

    @property
    def unmodelled_error(self) -> float:
        """Error over the mean, the cause of a change being unknown: the change itself, zero if it is insignificant."""
        return abs(self.change) if self.significant else 0.0


@dataclass(frozen=True)
class Velocity:
    """Velocity of a centroid."""

    value: float  # [px per frame]: positive to the right
    error: float
    scatter: float  # [px]: root mean square of the places about the straight line
    drift: Drift | None  # change of the velocity; missing for three frames


def times_of(frames: Floats, places: Floats, variance: Floats) -> Floats:
    """Return the times of frames, some of which a camera dropped or repeated unseen : (n,) array, in frames."""
    # steps from frame to frame are almost alike: where one is twice as long, a frame is missing
    steps = np.diff(places)
    step = float(np.median(steps / np.diff(frames)))
    if abs(step) < _DISTINCT * np.sqrt(2.0 * float(variance.max())):
        return frames
    passed = np.rint(steps / step)
    if np.any(passed < 0.0) or np.any(np.abs(steps / step - passed) > _WHOLE):
        return frames
    return np.concatenate([frames[:1], frames[0] + np.cumsum(passed)])


def repeated(frames: Floats, places: Floats, variance: Floats) -> bool:
    """Return whether a capsule stands still in many steps and moves by a distinct one in the others."""
    # a few repeated frames are found by `times_of`; if every other one is, its step may be that of two frames or of one
    steps = np.abs(np.diff(places) / np.diff(frames))
    step = float(np.quantile(steps, _MOVING))
    distinct = step > _DISTINCT * np.sqrt(2.0 * float(variance.max()))
    still = (steps == 0.0) | (distinct & (steps < _STILL * step))
    short = np.count_nonzero(~still & (steps < 0.5 * step))
    return bool(step > 0.0 and np.mean(still) > _COPIES and short <= _STILL * len(steps))


def velocity(frames: Floats, places: Floats, variance: Floats) -> Velocity:
    """Fit a straight line to places, and a parabola for the change of its slope."""
    # the error is that of the scatter about the line, or of the places if larger: in a few frames the scatter may be
    # small by chance
    t = frames - frames.mean()
    slope, error, scatter = _last_coefficient(t, places, 1, variance)
    if len(t) < 4:
        return Velocity(slope, error, scatter, None)
    bend, bend_error, _ = _last_coefficient(t, places, 2, variance)
    scale = 2.0 * np.ptp(t) / abs(slope)
    return Velocity(slope, error, scatter, Drift(float(np.sign(slope) * bend * scale), float(bend_error * scale)))


def drift(along: Floats, values: Floats, variance: Floats) -> Drift:
    """Return the change of a quantity along the channel."""
    slope, error, _ = _last_coefficient(along - along.mean(), values, 1, variance)
    scale = float(along[-1] - along[0]) / float(values.mean())
    return Drift(slope * scale, error * abs(scale))


def _last_coefficient(t: Floats, values: Floats, degree: int, variance: Floats) -> tuple[float, float, float]:
    """Return the highest coefficient of a fitted polynomial, its standard error, and the scatter about the fit."""
    span = float(np.max(np.abs(t)))
    design = (t / span)[:, None] ** np.arange(degree + 1)
    inverse = np.linalg.inv(design.T @ design)
    coefficients = inverse @ design.T @ values
    scatter = np.sum((values - design @ coefficients) ** 2) / (len(t) - degree - 1)
    error = np.sqrt(inverse[-1, -1] * max(scatter, float(variance.mean())))
    return float(coefficients[-1]) / span**degree, float(error) / span**degree, float(np.sqrt(scatter))
