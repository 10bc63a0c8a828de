"""The best shape of a model for each capsule, and what is left over.

Each capsule has its own Ca and a/l; they are found by Gauss-Newton steps, for
all capsules together, so that many models can be compared. What is left over is
*whitened*: of independent numbers with variance one if the model is right. The
covariance that does this is made once, at a pilot, and kept for all models that
are compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from capsbayes.discrepancy.session import Session
from capsbayes.inference.outline_likelihood import OutlineLikelihood, outline_likelihood
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction

__all__ = ["Fits", "Whitening", "fitted", "whitening"]

Floats = NDArray[np.float64]
Evaluated = tuple[list[Floats], list[Floats], Floats, Floats]

_STEPS = 12
_DIFFERENCE = (1e-3, 1e-4)  # of log Ca and a/l, for derivatives
_LONGEST = (0.3, 0.03)  # step
_LOOSE = np.array([2.0, 1.0])  # standard deviations of a prior about the start: it holds what the data leave open
_SETTLED = 1e-4  # of the misfit that is still to be gained
_NEAR = 0.1  # of the misfit still to be gained, from which a capsule counts as not fitted
_SCOUTS = (60, 40)


class Whitener(Protocol):
    """What is left of one capsule's measurement beside predictions."""

    def __call__(self, prediction: Prediction) -> Floats:
        """Whitened differences (k, m) from k predictions, NaN outside the model's domain."""
        ...


@dataclass(frozen=True, eq=False)
class OfLengths:
    """Measured lengths (1,) or (2,) with the factor of their covariance, the model's own error included."""

    lengths: Floats
    factor: Floats

    def __call__(self, prediction: Prediction) -> Floats:
        """See `Whitener`."""
        away = self.lengths - prediction.values[:, : len(self.lengths)]
        white = np.full_like(away, np.nan)
        known = prediction.inside
        white[known] = scipy.linalg.solve_triangular(self.factor, away[known].T, lower=True).T
        return white


@dataclass(frozen=True, eq=False)
class OfOutline:
    """A measured outline; its likelihood holds the covariance."""

    likelihood: OutlineLikelihood

    def __call__(self, prediction: Prediction) -> Floats:
        """See `Whitener`."""
        assert prediction.outline is not None, "asked for"
        outlines = np.where(prediction.inside[:, None, None], prediction.outline, np.nan)
        return self.likelihood.whitened(outlines, prediction.axial_length)


@dataclass(frozen=True, eq=False)
class Whitening:
    """One whitener for each capsule, and where it was made.

    Parameters
    ----------
    each : tuple of n Whitener
    pilots : (n, 2) array
        log Ca and a/l.
    outline : bool
        Whether any of them reads outlines.
    """

    each: tuple[Whitener, ...]
    pilots: Floats
    outline: bool


@dataclass(frozen=True, eq=False)
class Fits:
    """The best shapes of a model for n capsules.

    Parameters
    ----------
    theta : (n, 2) array
        log Ca and a/l.
    residuals : tuple of n (m,) arrays
        Whitened.
    slopes : tuple of n (m, 2) arrays
        Their derivatives along log Ca and a/l.
    log_modulus, size : (n,) arrays
        ln G_s [N/m] at the mean viscosity, and a/l.
    covariance : (n, 2, 2) array
        Of ln G_s and a/l.
    settled : (n,) bool array
        Whether the steps came to the least misfit, within the model's domain.
    """

    theta: Floats
    residuals: tuple[Floats, ...]
    slopes: tuple[Floats, ...]
    log_modulus: Floats
    size: Floats
    covariance: Floats
    settled: NDArray[np.bool_]

    @property
    def misfit(self) -> Floats:
        """Sum of the squares of what is left of each capsule : (n,) array."""
        return np.array([residual @ residual for residual in self.residuals])

    @property
    def freedom(self) -> NDArray[np.int64]:
        """Numbers measured of each capsule less the two that are fitted : (n,) array."""
        return np.array([len(residual) - 2 for residual in self.residuals])


def whitening(model: ForwardModel, session: Session) -> Whitening:
    """The covariance of each capsule's measurement and of the model's own error there.

    It is made at the shape that the lengths have, and once more at that which fits the outline.

    Raises
    ------
    InputError
        If a capsule has a shape that the model has not.
    """
    pilots = _pilots(model, session)
    outline = any(one.outline is not None for one in session.measurements)
    made = Whitening(_whiteners(model, session, pilots), pilots, outline)
    if not outline:
        return made
    better = fitted(model, session, made)
    pilots = np.where(better.settled[:, None], better.theta, pilots)
    return Whitening(_whiteners(model, session, pilots), pilots, outline)


def fitted(
    model: ForwardModel,
    session: Session,
    white: Whitening,
    sizes: Mapping[str, ArrayLike] | None = None,
    start: Floats | None = None,
) -> Fits:
    """Fit a model to every capsule.

    Parameters
    ----------
    model : ForwardModel
    session : Session
    white : Whitening
        Made with the model without effects.
    sizes : mapping of str to float or (n,) array, optional
        Parameters of effects of the model.
    start : (n, 2) array, optional
        log Ca and a/l to begin at, in place of the pilots; outside the model's domain the pilots take its place.
    """
    rest = {name: np.broadcast_to(np.asarray(value, float), len(session)) for name, value in (sizes or {}).items()}
    rest = {**session.circumstances, **rest}
    centre = white.pilots
    theta, (best, slopes, ratio, ratio_slopes) = _begun(model, white, rest, start)
    value = _penalised(best, theta, centre)
    damping, moving = np.full(len(theta), 1e-3), np.isfinite(value)
    for _ in range(_STEPS):
        step, promised = _step(best, slopes, theta, centre, damping)
        moving &= promised > _SETTLED
        if not moving.any():
            break
        trial = np.where(moving[:, None], theta + step, theta)
        found, found_slopes, found_ratio, found_ratio_slopes = _evaluated(model, white, rest, trial)
        there = _penalised(found, trial, centre)
        good = moving & (there < value + 1e-9)
        for i in np.flatnonzero(good):
            theta[i], best[i], slopes[i], value[i] = trial[i], found[i], found_slopes[i], there[i]
            ratio[i], ratio_slopes[i] = found_ratio[i], found_ratio_slopes[i]
        damping = np.where(good, damping / 10.0, damping * 10.0)
        moving &= damping < 1e8
    known = np.isfinite(value) & np.array([np.isfinite(slope).all() for slope in slopes], dtype=bool)
    left = _step(best, slopes, theta, centre, damping)[1]
    return _made(session, theta, best, slopes, ratio, ratio_slopes, known & (left < _NEAR))


def _begun(
    model: ForwardModel, white: Whitening, rest: Mapping[str, Floats], start: Floats | None
) -> tuple[Floats, Evaluated]:
    """Where to begin (n, 2), and what is there."""
    theta = np.array(white.pilots if start is None else start)
    found = _evaluated(model, white, rest, theta)
    outside = np.array([not np.isfinite(residual).all() for residual in found[0]])
    if start is None or not outside.any():
        return theta, found
    theta[outside] = white.pilots[outside]
    return theta, _evaluated(model, white, rest, theta)


def _made(
    session: Session,
    theta: Floats,
    residuals: list[Floats],
    slopes: list[Floats],
    ratio: Floats,
    ratio_slopes: Floats,
    settled: NDArray[np.bool_],
) -> Fits:
    speed = session.circumstances["capsule_velocity"] / ratio
    log_modulus = np.log(session.mean("viscosity") * speed) - theta[:, 0]
    covariance = np.full((len(theta), 2, 2), np.nan)
    for i, slope in enumerate(slopes):
        if np.isfinite(slope).all():
            spread = np.linalg.inv(slope.T @ slope + np.diag(1.0 / _LOOSE**2))
            along = np.array([[-1.0 - ratio_slopes[i, 0] / ratio[i], -ratio_slopes[i, 1] / ratio[i]], [0.0, 1.0]])
            covariance[i] = along @ spread @ along.T
    covariance[:, 0, 0] += np.square(session.velocity_errors)
    return Fits(theta, tuple(residuals), tuple(slopes), log_modulus, theta[:, 1], covariance, settled)


def _evaluated(model: ForwardModel, white: Whitening, rest: Mapping[str, Floats], theta: Floats) -> Evaluated:
    """Residual (m,) and slopes (m, 2) of each capsule, v_o/U (n,) and its slopes (n, 2)."""
    shifts = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]) * _DIFFERENCE
    points = (theta[:, None] + shifts).reshape(-1, 2)
    batch = {name: np.repeat(values, len(shifts)) for name, values in rest.items()}
    batch |= {"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
    prediction = model(batch, outline=white.outline)
    ratio = prediction.velocity_ratio.reshape(-1, len(shifts))
    residuals, slopes = [], []
    for i, whitener in enumerate(white.each):
        here = whitener(prediction.taken(slice(len(shifts) * i, len(shifts) * (i + 1))))
        residuals.append(here[0])
        slopes.append(np.stack([_slope(here, axis) for axis in range(2)], axis=1))
    ratio_slopes = np.stack([_slope(ratio.T, axis) for axis in range(2)], axis=1)
    return residuals, slopes, ratio[:, 0], ratio_slopes


def _slope(values: Floats, axis: int) -> Floats:
    """Derivative from rows (here, up, down, up, down), to one side where the other is outside the domain."""
    up, down, step = values[1 + 2 * axis], values[2 + 2 * axis], _DIFFERENCE[axis]
    central = (up - down) / (2.0 * step)
    forth, back = (up - values[0]) / step, (values[0] - down) / step
    return np.where(np.isfinite(central), central, np.where(np.isfinite(forth), forth, back))


def _step(
    residuals: list[Floats], slopes: list[Floats], theta: Floats, centre: Floats, damping: Floats
) -> tuple[Floats, Floats]:
    """Damped Gauss-Newton step (n, 2), and by how much the whole one would lower what is minimised (n,)."""
    step, promised = np.zeros_like(theta), np.zeros(len(theta))
    for i, (residual, slope) in enumerate(zip(residuals, slopes, strict=True)):
        if not (np.isfinite(residual).all() and np.isfinite(slope).all()):
            continue
        matrix = slope.T @ slope + np.diag(1.0 / _LOOSE**2)
        pull = slope.T @ residual + (theta[i] - centre[i]) / _LOOSE**2
        promised[i] = pull @ np.linalg.solve(matrix, pull)
        step[i] = -np.linalg.solve(matrix + damping[i] * np.diag(np.diag(matrix)), pull)
    return np.clip(step, -np.array(_LONGEST), _LONGEST), promised


def _penalised(residuals: list[Floats], theta: Floats, centre: Floats) -> Floats:
    """What is minimised : (n,) array, infinite outside the domain."""
    misfit = np.array([residual @ residual for residual in residuals])
    found = misfit + np.sum(((theta - centre) / _LOOSE) ** 2, axis=1)
    return np.where(np.isfinite(found), found, np.inf)


def _pilots(model: ForwardModel, session: Session) -> Floats:
    """log Ca and a/l (n, 2) of the shape that is nearest by its lengths."""
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    columns = np.linspace(size_low, size_high, _SCOUTS[1] + 2)[1:-1]
    ca, size = np.meshgrid(np.geomspace(ca_low, ca_high, _SCOUTS[0] + 2)[1:-1], columns)
    scouts = model({"capillary_number": ca.ravel(), "size_ratio": size.ravel()})
    known = np.flatnonzero(scouts.inside)
    shapes = scouts.taken(known)
    pilots = np.empty((len(session), 2))
    for i, one in enumerate(session.measurements):
        lengths, factor = _lengths(one, np.zeros((2, 2)))
        away = np.square(OfLengths(lengths, factor)(shapes))
        nearest = known[int(np.argmin(np.sum(away, axis=1)))]
        pilots[i] = np.log(ca.ravel()[nearest]), size.ravel()[nearest]
    return pilots


def _lengths(measurement: Measurement, own: Floats) -> tuple[Floats, Floats]:
    """Measured lengths (k,) and the factor (k, k) of their covariance with the model's `own` (2, 2)."""
    lengths = measurement.lengths
    covariance = measurement.covariance + own[: len(lengths), : len(lengths)]
    return lengths, scipy.linalg.cholesky(covariance, lower=True)


def _whiteners(model: ForwardModel, session: Session, pilots: Floats) -> tuple[Whitener, ...]:
    theta = {"capillary_number": np.exp(pilots[:, 0]), "size_ratio": pilots[:, 1]}
    own = model(theta).covariance[:, :2, :2]
    each: list[Whitener] = []
    for i, one in enumerate(session.measurements):
        if one.outline is None:
            each.append(OfLengths(*_lengths(one, own[i])))
        else:
            place = float(np.exp(pilots[i, 0])), float(pilots[i, 1])
            each.append(OfOutline(outline_likelihood(model, one.outline, *place, length=one.length_beside_outline)))
    return tuple(each)
