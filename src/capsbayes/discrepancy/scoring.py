"""How likely a session is under a model with an effect of a given size.

Of each capsule the best shape and its misfit say how well the picture is met;
how far the apparent shear moduli of all capsules lie apart says whether one
membrane can have made them. With G_s normal in its logarithm among the capsules
and the size a/l free, the likelihood of capsule i is, but for a constant,

    exp(-misfit_i / 2) (det C_i)^(1/2) N(ln G_i; mean, C_i[G, G] + spread^2),

C_i the covariance of ln G_i and a/l.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from capsbayes.discrepancy.fits import Fits, Whitening, fitted
from capsbayes.discrepancy.session import Session
from capsbayes.effect import Effect, ExtendableModel

__all__ = ["Population", "Scores", "log_likelihood", "population", "scored"]

Floats = NDArray[np.float64]

_QUANTILES = (0.02, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 0.98)  # of the prior, at which an effect is tried first
_REFINED = 3  # halvings of the steps about the best size
_LARGEST_SPREAD = 3.0
_LOST = 15.0  # log likelihood of a capsule that the model cannot have made, below that of the least likely other
_NOTHING = -1e6  # log likelihood of each where hardly one can have been made


@dataclass(frozen=True)
class Population:
    """ln G_s of the capsules: mean, and standard deviation beyond their errors."""

    mean: float
    spread: float


@dataclass(frozen=True, eq=False)
class Scores:
    """Log likelihood of each capsule at a few sizes of an effect.

    Parameters
    ----------
    effect : Effect
    sizes : (J,) array
        Rising; the null value among them.
    log_likelihood : (J, n) array
        With the population that is most likely at each size.
    elsewhere : (J,) array
        Log likelihood of what was measured of the effect apart from the capsules.
    """

    effect: Effect
    sizes: Floats
    log_likelihood: Floats = field(repr=False)
    elsewhere: Floats = field(repr=False)

    @property
    def total(self) -> Floats:
        """Of all that was measured : (J,) array."""
        return np.asarray(self.log_likelihood.sum(axis=1) + self.elsewhere)

    @property
    def gain(self) -> float:
        """Of all that was measured, at the best size over that at the null value."""
        return float(self.total[self.best] - self.total[self.null])

    @property
    def null(self) -> int:
        """Row of the null value."""
        return int(np.argmin(np.abs(self.sizes - self.effect.null_value)))

    @property
    def best(self) -> int:
        """Row of the likeliest size."""
        return int(np.argmax(self.total))

    @property
    def size(self) -> float:
        """The likeliest size."""
        return float(self.sizes[self.best])

    @property
    def gains(self) -> Floats:
        """Log likelihood of each capsule at the best size over that at the null value : (n,) array."""
        return np.asarray(self.log_likelihood[self.best] - self.log_likelihood[self.null])

    def interval(self, drop: float = 0.5) -> tuple[float, float]:
        """Sizes at which the log likelihood has fallen by `drop` from its best; 0.5 for 68 %."""
        lost = self.total.max() - self.total
        below, above = self.sizes[: self.best + 1], self.sizes[self.best :]
        low = np.interp(-drop, -lost[: self.best + 1], below) if lost[0] > drop else below[0]
        high = np.interp(drop, lost[self.best :], above) if lost[-1] > drop else above[-1]
        return float(low), float(high)


def scored(
    model: ExtendableModel,
    effect: Effect,
    session: Session,
    white: Whitening,
    measured: tuple[float, float] | None = None,
) -> Scores:
    """Try an effect at sizes over its prior, the more finely the nearer to the best.

    Parameters
    ----------
    model : forward model
        Without the effect.
    effect : Effect
    session : Session
    white : Whitening
        Made with the model.
    measured : (float, float), optional
        Size of the effect as measured apart from the capsules, and its standard error.
    """
    extended, name = model + effect, effect.parameter.name
    found: dict[float, Floats] = {}
    places: dict[float, Floats] = {}

    def add(size: float) -> None:
        if size not in found:
            near = min(places, key=lambda other: abs(other - size), default=None)
            fits = fitted(extended, session, white, {name: size}, None if near is None else places[near])
            found[size], places[size] = log_likelihood(fits), fits.theta

    for size in sorted({effect.null_value, *_first_sizes(effect, measured)}):
        add(size)
    for _ in range(_REFINED):
        sizes = sorted(found)
        best = int(np.argmax([found[size].sum() + _elsewhere(size, measured) for size in sizes]))
        for other in (best - 1, best + 1):
            if 0 <= other < len(sizes):
                add(0.5 * (sizes[best] + sizes[other]))
    sizes = sorted(found)
    elsewhere = np.array([_elsewhere(size, measured) for size in sizes])
    return Scores(effect, np.array(sizes), np.array([found[size] for size in sizes]), elsewhere)


def _first_sizes(effect: Effect, measured: tuple[float, float] | None) -> list[float]:
    """Sizes at which an effect is tried first: over its prior, and about what was measured of it."""
    low, high = effect.prior.support()
    about = [] if measured is None else [measured[0] + sigma * measured[1] for sigma in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    return [*(float(one) for one in effect.prior.ppf(_QUANTILES)), *(one for one in about if low <= one <= high)]


def _elsewhere(size: float, measured: tuple[float, float] | None) -> float:
    return 0.0 if measured is None else -0.5 * ((size - measured[0]) / measured[1]) ** 2


def population(values: Floats, variances: Floats) -> Population:
    """The likeliest mean and spread of normal values (n,) known with errors of given variances (n,)."""

    def mean(spread: float) -> float:
        weight = 1.0 / (variances + spread**2)
        return float(np.sum(weight * values) / np.sum(weight))

    def surprise(spread: float) -> float:
        total = variances + spread**2
        return float(np.sum((values - mean(spread)) ** 2 / total + np.log(total)))

    found = minimize_scalar(surprise, bounds=(0.0, _LARGEST_SPREAD), method="bounded")
    spread = float(found.x) if found.fun < surprise(0.0) else 0.0
    return Population(mean(spread), spread)


def log_likelihood(fits: Fits) -> Floats:
    """Log likelihood of each capsule : (n,) array; one that the model cannot have made counts as very unlikely."""
    done, values, variances = fits.settled, fits.log_modulus, fits.covariance[:, 0, 0]
    found = np.full(len(done), _NOTHING)
    if done.sum() > 1:
        people = population(values[done], variances[done])
        total = variances[done] + people.spread**2
        volume = np.linalg.slogdet(fits.covariance[done])[1]
        apart = (values[done] - people.mean) ** 2 / total + np.log(2.0 * np.pi * total)
        found[done] = -0.5 * fits.misfit[done] + 0.5 * volume - 0.5 * apart
        found[~done] = found[done].min() - _LOST
    return found
