"""Trend of the apparent shear modulus with velocity and size: what lengths alone leave to something else."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy.special import logsumexp

from capsbayes.arrays import Floats
from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.smooth_features import smooth_features

_LENGTHS = np.array([0.7, 0.15])  # length scales of ln v_o and of a/l
_AMPLITUDES = (0.05, 0.1, 0.2, 0.4)  # of ln G_s
_SPREADS = (0.02, 0.05, 0.1, 0.2, 0.4)  # of ln G_s between capsules
_LEVEL = 3.0  # standard deviation of the mean of ln G_s
_FEWEST = 6


@dataclass(frozen=True, eq=False)
class Trend:
    """Apparent G_s of n capsules, against which a smooth function of velocity and a/l is tried."""

    places: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2): ln v_o and a/l
    log_modulus: Floats = field(default_factory=lambda: np.zeros(0))  # (n,)
    variance: Floats = field(default_factory=lambda: np.zeros(0))  # (n,): of ln G_s by the errors of measurement
    shared: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (n, 2): covariance of these errors and places

    @classmethod
    def of(cls, session: Session, fits: Fits) -> Trend:
        """Collect it from the fits of a session."""
        done = fits.settled & ~fits.ill
        velocity = np.log(session.circumstances["capsule_velocity"])
        shared = np.stack([np.square(session.velocity_errors), fits.covariance[:, 0, 1]], axis=1)
        places = np.stack([velocity, fits.size], axis=1)
        return cls(places[done], fits.log_modulus[done], fits.covariance[done, 0, 0], shared[done])

    def __add__(self, other: Trend) -> Trend:
        """Return that of the capsules of both."""
        return Trend(
            np.concatenate([self.places, other.places]),
            np.concatenate([self.log_modulus, other.log_modulus]),
            np.concatenate([self.variance, other.variance]),
            np.concatenate([self.shared, other.shared]),
        )

    @property
    def evidence(self) -> float:
        """Log evidence of a trend relative to none; zero for a few capsules."""
        if len(self.log_modulus) < _FEWEST:
            return 0.0
        values, variance = self._without_shared_errors()
        features = np.hstack([_LEVEL * np.ones((len(values), 1)), smooth_features(self.places, _LENGTHS)])

        def average(amplitudes: tuple[float, ...]) -> float:
            found = [
                _log_density(values, variance + spread**2, features * _scale(features, amplitude))
                for amplitude, spread in product(amplitudes, _SPREADS)
            ]
            return float(logsumexp(found) - np.log(len(found)))

        return average(_AMPLITUDES) - average((0.0,))

    def _without_shared_errors(self) -> tuple[Floats, Floats]:
        """Return ln G_s (n,) less its mean and what errors shared with the places make of it, and its variance."""
        away = self.places - self.places.mean(axis=0)
        spread = away.T @ away / len(away) + 1e-8 * np.eye(2)
        slopes = np.linalg.solve(spread, self.shared.T).T
        values = self.log_modulus - np.sum(slopes * away, axis=1)
        variance = self.variance - np.sum(slopes * self.shared, axis=1)
        return values - np.median(values), np.maximum(variance, 0.1 * self.variance)


def _scale(features: Floats, amplitude: float) -> Floats:
    """Return the factors of the features: one of the level, the amplitude of the others."""
    return np.concatenate([[1.0], np.full(features.shape[1] - 1, amplitude)])


def _log_density(values: Floats, variance: Floats, features: Floats) -> float:
    """Return the log density of normal values (n,) of independent variances and a process of given features (n, r)."""
    root = 1.0 / np.sqrt(variance)
    seen = features * root[:, None]
    factor = np.linalg.cholesky(np.eye(features.shape[1]) + seen.T @ seen)
    explained = np.linalg.solve(factor, seen.T @ (values * root))
    square = np.sum((values * root) ** 2) - explained @ explained
    return float(-0.5 * square - np.sum(np.log(np.diag(factor))) + np.sum(np.log(root)))
