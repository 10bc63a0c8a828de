"""The measurements of a batch, reduced to what depends on the shape: a few numbers of each capsule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from capsbayes.arrays import Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment
from capsbayes.infer.outline.likelihood import OutlineLikelihood, SilhouetteLength
from capsbayes.infer.outline.normal_distance import normal_distances
from capsbayes.measured_outline import MeasuredOutline
from capsbayes.measurement import Measurement
from capsbayes.surrogate import MembraneSurrogate

_UNSEEN = 1e3  # [l] standard error of a length that was not measured
_SAME_FLOW = 0.25  # of ln U, within which capsules are of one flow
_TRIED = 20  # stored shapes of the size of an outline, of which the nearest is the first pilot
_PILOTS = 2  # shapes about which the distances of an outline are linear, one after the other


class Reduced(NamedTuple):
    """One measured shape: up to a constant, minus twice its log likelihood is |target - rows numbers|^2.

    Parameters
    ----------
    rows : (q, k) array
    target : (q,) array
    scale : (q,) array
        Change of rows numbers if the capsule is larger, relative.
    left : float
        Misfit that no shape takes away.
    known : int
        Number of measured numbers.
    """

    rows: Floats
    target: Floats
    scale: Floats
    left: float
    known: int


@dataclass(frozen=True, eq=False)
class Batch:
    """Measured capsules that share a membrane.

    Parameters
    ----------
    rows, target, scale : (n, q, k), (n, q), (n, q) arrays
        See `Reduced`.
    left, known : (n,) arrays
    log_velocity, velocity_error : (n,) arrays
        ln(v_o / (m/s)) and the relative standard error, with that of the model once this is known; U in place of v_o,
        and infinite, where the flow rate alone was measured.
    log_mean_velocity : (n,) array
        ln(U / (m/s)) by the flow rate, NaN where none was given.
    group : (n,) array
        Number of the flow, slow to fast.
    scale_error, rate_error : float
        Relative standard errors that all share: of the lengths, of U by the flow rate.
    """

    rows: Floats
    target: Floats
    scale: Floats
    left: Floats
    known: Integers
    log_velocity: Floats
    velocity_error: Floats
    log_mean_velocity: Floats
    group: Integers
    scale_error: float
    rate_error: float

    def __len__(self) -> int:
        return len(self.target)

    def taken(self, rows: Integers) -> Batch:
        """Return some of the capsules, each as often as its row is named."""
        each: dict[str, Any] = {
            name: value[rows] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        return replace(self, **each)

    def with_model_error(self, covariances: Floats, ratio_error: Floats, sharing: Floats) -> Batch:
        """Return the same with the model's own error in the errors of the measurements.

        The error is nearly the same for capsules that have nearly the same Ca and a/l, and must not be averaged away
        over them: its variance counts as often as capsules share it. Then the mean over them is as uncertain as it is.

        Parameters
        ----------
        covariances : (n, k, k) array
            Of the error of the numbers.
        ratio_error : (n,) array
            Standard error of ln(v_o/U).
        sharing : (n,) array
            Number of the capsules that share it, the sum of the correlations.
        """
        own = sharing[:, None, None] * (self.rows @ covariances @ self.rows.swapaxes(1, 2))
        factor: Floats = np.asarray(np.linalg.cholesky(own + np.eye(own.shape[1])), dtype=np.float64)
        columns = np.concatenate([self.rows, self.target[..., None], self.scale[..., None]], axis=-1)
        white: Floats = np.asarray(np.linalg.solve(factor, columns), dtype=np.float64)
        velocity_error = np.hypot(self.velocity_error, np.sqrt(sharing) * ratio_error)
        rows, target, scale = white[..., :-2], white[..., -2], white[..., -1]
        return replace(self, rows=rows, target=target, scale=scale, velocity_error=velocity_error)


def batch_of(
    measurements: Sequence[Measurement], experiment: Experiment, model: MembraneSurrogate, *, scale_error: float = 0.0
) -> Batch:
    """Reduce the measurements of a batch.

    Parameters
    ----------
    measurements : sequence of Measurement
        All with outlines, or all with lengths alone, over l.
    experiment : Experiment
        Of all.
    model : MembraneSurrogate
    scale_error : float
        Relative standard error of the lengths that all capsules share, as that of the size of a pixel.

    Raises
    ------
    InputError
        If some capsules have outlines and others none.
    """
    with_outline = [measurement.outline is not None for measurement in measurements]
    if any(with_outline) and not all(with_outline):
        odd = measurements[with_outline.index(not with_outline[0])]
        expected = "outlines of all capsules of a batch, or of none"
        raise InputError(odd.source or "measurement", "outline", expected, "some with and some without")
    if all(with_outline):
        coefficients = model.stored_coefficients
        shapes = model.outlines_of(coefficients)
        reduced = [_of_outline(measurement, model, coefficients, shapes) for measurement in measurements]
    else:
        reduced = [_of_lengths(measurement) for measurement in measurements]
    width = experiment.half_width
    rates = [measurement.flow_rate or np.nan for measurement in measurements]
    rate_errors = [(m.flow_rate_error or 0.0) / m.flow_rate for m in measurements if m.flow_rate]
    area = AREAS[experiment.cross_section] * width.value**2
    mean_velocity = np.log(np.array(rates) / area)
    missing = [m.capsule_velocity is None and bool(m.flow_rate) for m in measurements]
    speeds = [None if none else m.known_velocity for none, m in zip(missing, measurements, strict=True)]
    velocity = np.array([u if v is None else v.value for u, v in zip(np.exp(mean_velocity), speeds, strict=True)])
    errors = np.array([np.inf if speed is None else speed.error for speed in speeds])
    return Batch(
        rows=np.array([one.rows for one in reduced]),
        target=np.array([one.target for one in reduced]),
        scale=np.array([one.scale for one in reduced]),
        left=np.array([one.left for one in reduced]),
        known=np.array([one.known for one in reduced]),
        log_velocity=np.log(velocity),
        velocity_error=errors / velocity,
        log_mean_velocity=mean_velocity,
        group=_groups(np.where(np.isnan(mean_velocity), np.log(velocity), mean_velocity)),
        scale_error=scale_error,
        rate_error=float(np.hypot(max(rate_errors, default=0.0), 2.0 * width.error / width.value)),
    )


def _groups(log_speed: Floats) -> Integers:
    """Return the number of the flow of each capsule, by gaps and steps in the logarithm of its speed : (n,) array."""
    order = np.argsort(log_speed, kind="stable")
    group, begin = np.zeros(len(order), dtype=np.int64), log_speed[order[0]]
    for before, here in pairwise(order):
        step = log_speed[here] - begin > _SAME_FLOW
        begin = log_speed[here] if step else begin
        group[here] = group[before] + step
    return group


def _of_lengths(measurement: Measurement) -> Reduced:
    extent, length, seen = measurement.axial_extent, measurement.axial_length, measurement.covariance
    covariance = np.diag([0.0, _UNSEEN**2])
    covariance[: len(seen), : len(seen)] = seen
    rows: Floats = np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).T, dtype=np.float64)
    target = rows @ np.array([extent, extent if length is None else length])
    return Reduced(rows, target, target, 0.0, len(seen))


def _of_outline(measurement: Measurement, model: MembraneSurrogate, coefficients: Floats, shapes: Floats) -> Reduced:
    """Reduce an outline: its distances are linear in the coefficients of the modes about a pilot that is near it.

    `coefficients` (s, k) and `shapes` (s, p, 2) are those of the stored states.
    """
    assert measurement.outline is not None
    found = coefficients[_nearest(measurement.outline, shapes)]
    length = measurement.length_with_outline
    reduced = _linear(measurement.outline, length, model, found)
    for _ in range(_PILOTS):
        # of the shapes that the states have, the nearest to what was measured
        spread = coefficients.std(axis=0)
        ridge = np.column_stack([np.diag(1.0 / spread), np.zeros(len(spread))])
        rows, right = np.concatenate([reduced.rows, ridge]), np.concatenate([reduced.target, found / spread])
        found = np.linalg.lstsq(rows, right, rcond=None)[0][:-1]
        reduced = _linear(measurement.outline, length, model, found)
    return reduced


def _nearest(outline: MeasuredOutline, shapes: Floats) -> int:
    """Return the number of the shape (s, p, 2) that is nearest to an outline, of some that have its size."""
    sizes, measured = np.ptp(shapes, axis=1), np.ptp(outline.points, axis=0)
    some = np.argsort(np.sum((sizes - measured) ** 2, axis=1), kind="stable")[:_TRIED]
    distances = normal_distances(outline.points, shapes[some], posed=True)
    return int(some[np.argmin(np.sum(distances**2, axis=1))])


def _linear(
    outline: MeasuredOutline, length: tuple[float, float] | None, model: MembraneSurrogate, pilot: Floats
) -> Reduced:
    """Return a measured outline linear about a pilot, whose coefficients (k,) these are."""
    shape = model.outlines_of(pilot[None])[0]
    silhouette = None if length is None else SilhouetteLength(*length)
    likelihood = OutlineLikelihood(outline.points, outline.noise, shape, outline.pose, length=silhouette)
    axial = np.zeros(1) if length is not None else None
    begin = likelihood.whitened(shape[None], axial)[0]
    columns = likelihood.whitened_prediction(np.concatenate([model.mode_shapes, shape[None]]))
    own = np.zeros((1, len(begin))) if length is None else likelihood.whitened_length()[None]
    every = np.concatenate([columns[:-1], own, columns[-1:]]).T  # modes, L_a, scale
    target = begin + columns[:-1].T @ pilot
    lacking = max(every.shape[1] - len(every), 0)  # an outline of few points: as many rows for all, the others of zeros
    every, target = np.pad(every, ((0, lacking), (0, 0))), np.pad(target, (0, lacking))
    q, r = scipy.linalg.qr(every, mode="economic")
    reduced = q.T @ target
    left = float(target @ target - reduced @ reduced)
    scale = r[:, -1] + (0.0 if length is None else length[0]) * r[:, -2]
    return Reduced(r[:, :-1], reduced, scale, max(left, 0.0), len(begin))
