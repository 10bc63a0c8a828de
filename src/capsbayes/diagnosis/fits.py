"""Fits of a session by a model, and trends of what they leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.diagnosis.session import (
    Evaluation,
    FlowOffsets,
    Places,
    Session,
    Whitening,
    flow_offsets,
    initial_guesses,
)
from capsbayes.model import ForwardModel
from capsbayes.run import remembered

# Features of a squared-exponential Gaussian process over a few coordinates, about a lattice of inducing points

_POINTS = 3  # of the lattice along each coordinate
_JITTER = 1e-8


def smooth_features(places: Floats, lengths: Floats) -> Floats:
    """Return features (n, 3^d) of places (n, d) whose products are the covariances of a process of variance one."""
    # The covariance is projected onto a lattice over the range of the places (Quiñonero-Candela & Rasmussen 2005, J.
    # Mach. Learn. Res. 6, 1939), good where this range is no more than a few length scales (d,).
    low, high = places.min(axis=0) / lengths, places.max(axis=0) / lengths
    axes = [np.linspace(*ends, _POINTS) for ends in zip(low, high, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(lengths))
    within = _kernel(lattice, lattice) + _JITTER * np.eye(len(lattice))
    factor = np.linalg.cholesky(within)
    return np.asarray(scipy.linalg.solve_triangular(factor, _kernel(lattice, places / lengths), lower=True).T)


def _kernel(first: Floats, second: Floats) -> Floats:
    return np.asarray(np.exp(-0.5 * np.sum((first[:, None] - second) ** 2, axis=-1)))


def log_evidences(information: Floats, shifts: Floats, variances: Floats) -> Floats:
    """Return the log evidence, relative to none, of normal amplitudes for each of some shifts (q, N) : (N,) array."""
    # The information (q, q) is that of the data alone; a shift (q,) is it times the likeliest amplitudes.
    seen, log_volume = _whitened(information, shifts, variances)
    return np.asarray(0.5 * np.sum(seen**2, axis=1) - log_volume)


def _whitened(information: Floats, columns: Floats, variances: Floats) -> tuple[Floats, float]:
    """Return columns (q, N) in units of what the data leave of amplitudes, as rows, and the log of what is lost."""
    used = variances > 0.0
    root = np.sqrt(variances[used])
    if not used.any():
        return np.zeros((columns.shape[1], 0)), 0.0
    factor = np.linalg.cholesky(np.eye(len(root)) + root[:, None] * information[np.ix_(used, used)] * root)
    seen = scipy.linalg.solve_triangular(factor, root[:, None] * columns[used], lower=True)
    return np.asarray(seen.T), float(np.sum(np.log(np.diag(factor))))


# Best shape of a model for each capsule: its own Ca and a/l, found for all capsules together, so that many models can
# be compared. The residuals are whitened with a covariance that is kept for all of them

_NEAR = 0.1  # expected decrease of the misfit above which a fit has not converged
_ILL = 4.0  # misfit over its freedom, from which a capsule has no shape of the model: twice the stated noise
_AGAIN = 2.0  # misfit over its freedom, over 1 or the usual one, from which a fit is sought from elsewhere too


@dataclass(frozen=True, eq=False)
class Fits:
    """Best shapes of a model for n capsules."""

    theta: Floats  # (n, 2): ln Ca and a/l
    residuals: tuple[Floats, ...]  # n arrays (m,), whitened
    slopes: tuple[Floats, ...]  # n arrays (m, 2): their derivatives along ln Ca and a/l
    log_modulus: Floats  # (n,): ln G_s [N/m] at the mean viscosity
    size: Floats  # (n,): a/l
    covariance: Floats  # (n, 2, 2): of ln G_s and a/l
    log_volume: Floats  # (n,): log determinant of it by the picture alone, without the error of the velocity
    known: Booleans  # (n,): whether the model has any shape for it
    settled: Booleans  # (n,): whether the steps came to the least misfit, and not to the border of the domain
    freedom: Integers  # (n,): numbers measured less those fitted: Ca, a/l, and place and tilt of an outline
    flow: FlowOffsets  # velocities over those that the flow rates give

    @property
    def ill(self) -> Booleans:
        """Capsules without a shape of the model: none, one at its border only, or a misfit far beyond the noise."""
        return ~(self.settled & (self.misfit < _ILL * np.maximum(self.freedom, 1)))

    @property
    def misfit(self) -> Floats:
        """Sum of the squared residuals of each capsule : (n,) array."""
        return np.array([residual @ residual for residual in self.residuals])

    def absorbed(self, row: int) -> Floats:
        """Return an orthonormal basis (m, 2) of the residuals of a capsule that Ca and a/l absorb."""
        return np.linalg.qr(self.slopes[row])[0]

    def left_of(self, row: int, changes: Floats) -> Floats:
        """Return what Ca and a/l leave of changes (..., m) of the residuals of a capsule."""
        basis = self.absorbed(row)
        return np.asarray(changes - (changes @ basis) @ basis.T)

    @property
    def median_modulus(self) -> float:
        """Median of the apparent G_s [N/m] of the settled capsules; NaN if none is."""
        return float(np.exp(np.median(self.log_modulus[self.settled]))) if self.settled.any() else np.nan


@remembered
def fitted(
    model: ForwardModel,
    session: Session,
    white: Whitening,
    sizes: Mapping[str, ArrayLike] | None = None,
    start: Floats | None = None,
    *,
    everywhere: bool = True,
) -> Fits:
    """Fit a model to every capsule, with the sizes of its effects."""
    # The whitening is made with this model, or with the one with which it is compared. Outside the model's domain the
    # pilots take the place of `start` (n, 2); `everywhere`, what is not fitted from there is tried from elsewhere.
    rest = {name: np.broadcast_to(np.asarray(value, float), len(session)) for name, value in (sizes or {}).items()}
    rest = {**session.circumstances, **rest}
    evaluate = Evaluation(model, white, rest)
    here = evaluate.fitted(_begun(evaluate, start), np.arange(len(session)))
    freedom = np.array([seen.count - 2 - seen.placed for seen in white.each])
    ill = _to_try_again(here, np.maximum(freedom, 1))
    if everywhere and len(ill):
        others = [evaluate(guess, ill) for guess in initial_guesses(model, session, rest, ill)]
        if start is not None:  # an earlier fit tried every start; the likeliest is enough now
            for other in others[1:]:
                others[0].take_better(np.arange(len(ill)), other)
            others = others[:1]
        for other in others:
            here.take_better(ill, evaluate.fitted(other, ill))
    return _made(session, evaluate, here, freedom)


def _begun(evaluate: Evaluation, start: Floats | None) -> Places:
    """Evaluate the capsules at a start (n, 2), or at their pilots where the model has no shape there."""
    pilots = evaluate.white.pilots
    places = evaluate(np.array(pilots if start is None else start), np.arange(len(pilots)))
    outside = np.flatnonzero(~places.inside)
    if start is not None and len(outside):
        places.put(outside, evaluate(pilots[outside], outside))
    return places


def _to_try_again(places: Places, freedom: Integers) -> Integers:
    """Return the capsules whose fit has not settled, or is worse than their noise or most other fits would make it."""
    misfit = places.square / freedom
    usual = min(float(np.median(misfit)), 1.0)  # less where the errors were stated too large
    return np.flatnonzero(~((misfit < _AGAIN * usual) & (places.left < _NEAR)))


def _made(session: Session, evaluate: Evaluation, places: Places, freedom: Integers) -> Fits:
    log_ca, size = places.points.T
    speed = session.circumstances["capsule_velocity"] / places.ratio
    known = places.inside & places.differentiable
    along = np.zeros((len(known), 2, 2))
    along[:, 0] = -places.ratio_slopes / places.ratio[:, None] - [1.0, 0.0]
    along[:, 1, 1] = 1.0
    covariance = np.full((len(known), 2, 2), np.nan)
    spread = np.full((len(known), 2, 2), np.nan)
    spread[known] = np.linalg.inv(places.normal[known])
    covariance[known] = np.einsum("nij,njk,nlk->nil", along[known], spread[known], along[known])
    log_volume = np.full(len(known), np.nan)
    log_volume[known] = np.linalg.slogdet(covariance[known])[1]
    covariance[:, 0, 0] += np.square(session.velocity_errors)
    of_data = [slice(2, 2 + seen.count) for seen in evaluate.white.each]
    return Fits(
        theta=places.points,
        residuals=tuple(values[part] for values, part in zip(places.residuals, of_data, strict=True)),
        slopes=tuple(values[part] for values, part in zip(places.slopes, of_data, strict=True)),
        log_modulus=np.log(session.circumstances["viscosity"] * speed) - log_ca,
        size=size,
        covariance=covariance,
        log_volume=log_volume,
        known=known,
        settled=known & (places.left < _NEAR),
        freedom=freedom,
        flow=flow_offsets(session, evaluate, places, spread),
    )


# Apparent shear moduli of the capsules: a trend with velocity and a/l, which is what lengths alone leave to something
# else, a drift in the order of the capsules, or two kinds of capsules

_LENGTHS = np.array([0.7, 0.15])  # length scales of ln v_o and of a/l
_OF_ORDER = np.array([0.5])  # length scale, over the whole session
_AMPLITUDES = (0.05, 0.1, 0.2, 0.4)  # of ln G_s
_SPREADS = (0.02, 0.05, 0.1, 0.2, 0.4)  # of ln G_s between capsules
_LEVEL = 3.0  # standard deviation of the mean of ln G_s
_FEWEST = 6
_LEVELS = np.linspace(-2.0, 2.0, 201)  # of ln G_s, for the lower of two kinds
_APART = tuple(range(5, 61, 5))  # of two kinds, in steps of the levels
_SHARES = (0.3, 0.5, 0.7)  # of the lower kind: a few capsules far out are no kind


class Kinds(NamedTuple):
    """Two kinds of capsules: log evidence relative to one, and how far apart their ln G_s lie, with the error."""

    evidence: float = 0.0
    apart: float = np.nan
    error: float = np.nan


@dataclass(frozen=True, eq=False)
class Trend:
    """Apparent G_s of n capsules, with what they may depend on."""

    places: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2): ln v_o and a/l
    log_modulus: Floats = field(default_factory=lambda: np.zeros(0))  # (n,)
    variance: Floats = field(default_factory=lambda: np.zeros(0))  # (n,): of ln G_s by the errors of measurement
    shared: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2): covariance of these errors and places
    order: Floats = field(default_factory=lambda: np.zeros(0))  # (n,): from 0 to 1

    @classmethod
    def of(cls, session: Session, fits: Fits) -> Trend:
        """Collect it from the fits of a session."""
        done = fits.settled & ~fits.ill
        velocity = np.log(session.circumstances["capsule_velocity"])
        shared = np.stack([np.square(session.velocity_errors), fits.covariance[:, 0, 1]], axis=1)
        places = np.stack([velocity, fits.size], axis=1)
        columns = places, fits.log_modulus, fits.covariance[:, 0, 0], shared, session.order
        return cls(*(column[done] for column in columns))

    @property
    def evidence(self) -> float:
        """Log evidence of a trend, a drift or two kinds, relative to none of them; zero for a few capsules."""
        if len(self.log_modulus) < _FEWEST:
            return 0.0
        each = self._smooth(self.places, _LENGTHS), self._smooth(self.order[:, None], _OF_ORDER), self.kinds.evidence
        return float(logsumexp(each) - np.log(len(each)))

    def _smooth(self, places: Floats, lengths: Floats) -> float:
        """Return the log evidence of a smooth function of places (n, d)."""
        values, errors = self._without_shared_errors()
        features = np.hstack([np.ones((len(values), 1)), smooth_features(places, lengths)])

        def log_density(amplitude: float, spread: float) -> float:
            variance = errors + spread**2
            weighted = features / variance[:, None]
            amplitudes = np.concatenate([[_LEVEL**2], np.full(features.shape[1] - 1, amplitude**2)])
            shift = (values @ weighted)[:, None]
            of_trend = float(log_evidences(features.T @ weighted, shift, amplitudes)[0])
            return of_trend - 0.5 * float(np.sum(values**2 / variance + np.log(variance)))

        def average(amplitudes: tuple[float, ...]) -> float:
            logs = [log_density(*sizes) for sizes in product(amplitudes, _SPREADS)]
            return float(logsumexp(logs) - np.log(len(logs)))

        return average(_AMPLITUDES) - average((0.0,))

    @cached_property
    def kinds(self) -> Kinds:
        """Two kinds of capsules, each with a normal ln G_s of the same spread."""
        if len(self.log_modulus) < _FEWEST:
            return Kinds()
        values, errors = self._without_shared_errors()
        one, two = np.empty(len(_SPREADS)), np.empty((len(_SPREADS), len(_APART), len(_SHARES)))
        for row, spread in enumerate(_SPREADS):
            variance = (errors + spread**2)[:, None]
            logs = -0.5 * ((values[:, None] - _LEVELS) ** 2 / variance + np.log(variance))
            one[row] = logsumexp(logs.sum(axis=0))
            for (column, apart), (layer, share) in product(enumerate(_APART), enumerate(_SHARES)):
                both = np.logaddexp(np.log(share) + logs[:, :-apart], np.log1p(-share) + logs[:, apart:])
                two[row, column, layer] = logsumexp(both.sum(axis=0))
        by_distance = logsumexp(two, axis=(0, 2))
        weights = np.exp(by_distance - logsumexp(by_distance))
        distances = (_LEVELS[1] - _LEVELS[0]) * np.array(_APART)
        mean = float(weights @ distances)
        evidence = logsumexp(two) - np.log(two.size) - (logsumexp(one) - np.log(one.size))
        return Kinds(float(evidence), mean, float(np.sqrt(weights @ (distances - mean) ** 2)))

    def _without_shared_errors(self) -> tuple[Floats, Floats]:
        """Return ln G_s (n,) less its mean and what errors shared with the places make of it, and its variance."""
        away = self.places - self.places.mean(axis=0)
        spread = away.T @ away / len(away) + 1e-8 * np.eye(2)
        slopes = np.linalg.solve(spread, self.shared.T).T
        values = self.log_modulus - np.sum(slopes * away, axis=1)
        variance = self.variance - np.sum(slopes * self.shared, axis=1)
        return values - np.median(values), np.maximum(variance, 0.1 * self.variance)
