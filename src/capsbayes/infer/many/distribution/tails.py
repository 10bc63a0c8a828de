"""Tails of a population: normal, or those of Student's t distribution as a mixture of normal distributions.

A t distribution of freedom nu is a normal one whose variance is divided by w, and w is gamma distributed with mean one
and shape nu / 2: K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84 (1989) 881. A few values of
w, equally spaced in log w, represent it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import special

from capsbayes.arrays import Floats, Integers

NORMAL, STUDENT = "normal", "student"
TAILS = (NORMAL, STUDENT)
"""Of a population: normal distributions of ln G_s at given size and of ln a, or t distributions."""

NODES = 5
_BEYOND = 1e-3  # probability of w beyond the nodes, on either side
_LOWEST, _HIGHEST = np.log([0.5, 500.0])  # log freedom
_USUAL, _FACTOR = 5.0, 1.0  # median of the log-normal prior of the freedom, and standard deviation of its logarithm
_ONE_SD = 0.6826894921370859  # probability of a normal variable within one standard deviation
_HALVINGS = 40


class ScaleMixture(NamedTuple):
    """Factors of the variance and their weights, for d populations : (d, j) arrays."""

    variance: Floats
    weight: Floats

    @classmethod
    def normal(cls, count: int) -> ScaleMixture:
        """Return normal tails."""
        return cls(np.ones((count, 1)), np.ones((count, 1)))

    @classmethod
    def of_freedom(cls, log_freedom: Floats) -> ScaleMixture:
        """Return the tails of t distributions.

        Parameters
        ----------
        log_freedom : (d,) array
        """
        half = 0.5 * np.exp(np.clip(log_freedom, _LOWEST, _HIGHEST))[:, None]
        low, high = (np.log(special.gammaincinv(half, share) / half) for share in (_BEYOND, 1.0 - _BEYOND))
        log_w = low + (high - low) * np.linspace(0.0, 1.0, NODES)
        log_density = half * (log_w - np.exp(log_w))
        weight = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        return cls(np.exp(-log_w), weight / weight.sum(axis=1, keepdims=True))

    def scaled(self, factor: Floats) -> ScaleMixture:
        """Return the mixtures of as many variables times a factor (d,)."""
        return self._replace(variance=self.variance * np.square(factor)[:, None])

    def plus(self, other: ScaleMixture) -> ScaleMixture:
        """Return the mixtures of the sums of independent variables."""
        variance, weight = self.variance[:, :, None] + other.variance[:, None], self.weight[:, :, None]
        rows = len(variance)
        return ScaleMixture(variance.reshape(rows, -1), (weight * other.weight[:, None]).reshape(rows, -1))

    def drawn(self, rng: np.random.Generator, rows: Integers) -> Floats:
        """Draw the standard deviations of members of some of the populations : (m,) rows -> (m,) array."""
        node = (np.cumsum(self.weight, axis=1)[rows, :-1] < rng.uniform(size=(len(rows), 1))).sum(axis=1)
        return np.asarray(np.sqrt(self.variance[rows, node]))


def half_width_of(variance: Floats, weight: Floats) -> Floats:
    """Return half the width of the central 68.3 % of mixtures of centred normal distributions.

    Of a normal distribution it is the standard deviation; of one with heavy tails, which may have none, it says how far
    two thirds of the population lie from the middle.

    Parameters
    ----------
    variance, weight : (d, j) arrays

    Returns
    -------
    (d,) array
    """
    sd = np.sqrt(variance)
    if sd.shape[1] == 1:
        return np.asarray(sd[:, 0])
    low, high = np.zeros(len(sd)), sd.max(axis=1)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        inside = np.sum(weight * special.erf(middle[:, None] / (np.sqrt(2.0) * sd)), axis=1)
        low, high = np.where(inside < _ONE_SD, middle, low), np.where(inside < _ONE_SD, high, middle)
    return np.asarray(high)


def log_prior_of_freedom(log_freedom: Floats) -> Floats:
    """Return the log prior density of the logarithm of the freedom; very low beyond 0.5 and 500."""
    values = -0.5 * ((log_freedom - np.log(_USUAL)) / _FACTOR) ** 2
    return np.where((log_freedom > _LOWEST) & (log_freedom < _HIGHEST), values, -1e10)
