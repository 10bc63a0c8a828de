"""Best shape of a model for each capsule, and its residuals.

Each capsule has its own Ca and a/l; they are found for all capsules together,
so that many models can be compared. The residuals are whitened, with a
covariance that is kept for all models that are compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.diagnosis.gauss_newton import LOOSE, Evaluation, Places, gauss_newton, initial_guesses
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import Whitening, whitened_at
from capsbayes.model import ForwardModel

_NEAR = 0.1  # expected decrease of the misfit above which a fit has not converged
_ILL = 4.0  # misfit over its freedom, from which a capsule has no shape of the model: twice the stated noise
_AGAIN = 2.0  # misfit over its freedom, from which a fit is sought from elsewhere too


@dataclass(frozen=True, eq=False)
class Fits:
    """Best shapes of a model for n capsules.

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
    known : (n,) bool array
        Whether the model has any shape for it.
    settled : (n,) bool array
        Whether the steps came to the least misfit, and not to the border of the model's domain.
    freedom : (n,) array
        Numbers measured of each capsule less those that are fitted: Ca, a/l, and place and tilt of an outline.
    """

    theta: Floats
    residuals: tuple[Floats, ...]
    slopes: tuple[Floats, ...]
    log_modulus: Floats
    size: Floats
    covariance: Floats
    known: Booleans
    settled: Booleans
    freedom: Integers

    @property
    def ill(self) -> Booleans:
        """Capsules without a shape of the model: none, one at its border only, or a misfit far beyond the noise."""
        return ~(self.settled & (self.misfit < _ILL * np.maximum(self.freedom, 1)))

    @property
    def misfit(self) -> Floats:
        """Sum of the squared residuals of each capsule : (n,) array."""
        return np.array([residual @ residual for residual in self.residuals])

    @property
    def median_modulus(self) -> float:
        """Median of the apparent G_s [N/m] of the settled capsules; NaN if none is."""
        return float(np.exp(np.median(self.log_modulus[self.settled]))) if self.settled.any() else np.nan


def whitening(model: ForwardModel, session: Session) -> Whitening:
    """Compute the covariance of each capsule's measurement and of the model's own error there.

    Evaluate it at the shape that fits the lengths, then again at the shape that fits the outline.

    Raises
    ------
    InputError
        If the model has no shape for a capsule.
    """
    pilots = initial_guesses(model, session, session.circumstances, np.arange(len(session)), bands=1)[0]
    made = whitened_at(model, session, pilots)
    if not made.outline:
        return made
    better = fitted(model, session, made)
    return whitened_at(model, session, np.where(better.settled[:, None], better.theta, pilots))


def fitted(
    model: ForwardModel,
    session: Session,
    white: Whitening,
    sizes: Mapping[str, ArrayLike] | None = None,
    start: Floats | None = None,
    *,
    everywhere: bool = True,
) -> Fits:
    """Fit a model to every capsule.

    Parameters
    ----------
    model : ForwardModel
    session : Session
    white : Whitening
        Made with this model, or with the one with which it is compared.
    sizes : mapping of str to float or (n,) array, optional
        Parameters of effects of the model.
    start : (n, 2) array, optional
        log Ca and a/l to begin at, in place of the pilots; outside the model's domain the pilots take its place.
    everywhere : bool
        Whether a capsule that is not fitted from there is tried again from elsewhere.
    """
    rest = {name: np.broadcast_to(np.asarray(value, float), len(session)) for name, value in (sizes or {}).items()}
    rest = {**session.circumstances, **rest}
    evaluate = Evaluation(model, white, rest)
    centre = white.pilots
    here = gauss_newton(evaluate, _begun(evaluate, start), np.arange(len(centre)))
    freedom = np.array([len(left) - 2 - seen.placed for left, seen in zip(here.residuals, white.each, strict=True)])
    ill = np.flatnonzero(~(here.penalised(centre) < _AGAIN * np.maximum(freedom, 1)))
    if everywhere and len(ill):
        others = [evaluate(guess, ill) for guess in initial_guesses(model, session, rest, ill)]
        if start is not None:  # an earlier fit tried every start; the likeliest is enough now
            for other in others[1:]:
                others[0].take_better(np.arange(len(ill)), other, centre[ill])
            others = others[:1]
        for other in others:
            here.take_better(ill, gauss_newton(evaluate, other, ill), centre)
    known = here.inside & here.differentiable
    settled = known & (here.step(centre, np.zeros(len(centre)))[1] < _NEAR)
    return _made(session, here, known, settled, freedom)


def _begun(evaluate: Evaluation, start: Floats | None) -> Places:
    """Evaluate the capsules at a start (n, 2), or at their pilots where the model has no shape there."""
    pilots = evaluate.white.pilots
    found = evaluate(np.array(pilots if start is None else start), np.arange(len(pilots)))
    outside = np.flatnonzero(~found.inside)
    if start is not None and len(outside):
        found.put(outside, evaluate(pilots[outside], outside))
    return found


def _made(
    session: Session,
    places: Places,
    known: Booleans,
    settled: Booleans,
    freedom: Integers,
) -> Fits:
    speed = session.circumstances["capsule_velocity"] / places.ratio
    log_modulus = np.log(session.circumstances["viscosity"] * speed) - places.theta[:, 0]
    covariance = np.full((len(settled), 2, 2), np.nan)
    for i in np.flatnonzero(known):
        slope = places.slopes[i]
        spread = np.linalg.inv(slope.T @ slope + np.diag(1.0 / LOOSE**2))
        by_ca, by_size = -places.ratio_slopes[i] / places.ratio[i]
        along = np.array([[by_ca - 1.0, by_size], [0.0, 1.0]])
        covariance[i] = along @ spread @ along.T
    covariance[:, 0, 0] += np.square(session.velocity_errors)
    each = tuple(places.residuals), tuple(places.slopes)
    return Fits(places.theta, *each, log_modulus, places.theta[:, 1], covariance, known, settled, freedom)
