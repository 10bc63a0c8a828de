"""Error of an effect's size by the model's own error, which all capsules of a session share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.noise import whitening
from capsbayes.diagnosis.scoring import Scores
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import OfOutline
from capsbayes.model import FixedParameters, ForwardModel

_STEP = 0.5  # of the half width of the 68 % interval


def with_own_error(model: ForwardModel, scores: Scores, session: Session) -> Scores:
    """Return the scores of an effect, added to a model, with the error of its size due to the model's own error."""
    return replace(scores, own_error=own_size_error(model, scores, session))


def own_size_error(model: ForwardModel, scores: Scores, session: Session) -> float:
    """Return the standard error of an effect's size by the model's own error, if that is the same in all capsules."""
    # Where an outline changes with the size, after Ca and a/l have absorbed what they can, the own error of each
    # capsule is taken in the direction that changes the size; zero without outlines.
    name = scores.effect.parameter.name
    extended = model + scores.effect
    low, high = scores.profile_interval()
    away = _STEP * max(0.5 * (high - low), 1e-4 * float(np.ptp(scores.sizes)))
    step = away if scores.size + away <= scores.sizes[-1] else -away
    white = whitening(FixedParameters(extended, {name: scores.size}), session)
    here = fitted(extended, session, white, {name: scores.size})
    there = fitted(extended, session, white, {name: scores.size + step}, here.theta, everywhere=False)
    moved, weight = 0.0, (2.0 / (high - low)) ** 2 if high > low else 0.0
    seen_change = 0.0
    for row in np.flatnonzero(here.settled & there.settled):
        seen = white.each[row]
        if isinstance(seen, OfOutline):
            change = (there.residuals[row] - here.residuals[row]) / step
            moved += float(np.linalg.norm(seen.errors_of_model() @ change))
            seen_change += float(change @ change)
    weight = max(weight, seen_change)  # the former counts the scatter of G_s too
    return moved / weight if weight > 0.0 else 0.0
