"""Errors of a session's measurements as they are stated, and the noise of its outlines beyond that."""

from __future__ import annotations

import numpy as np

from capsbayes.diagnosis.discrepancy import Discrepancy
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.places import initial_guesses
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import Whitening, whitened_at
from capsbayes.model import ForwardModel


def whitening(model: ForwardModel, session: Session, *, halves: int = 2) -> Whitening:
    """Compute the covariance of each capsule's measurement and of the model's own error there."""
    # Evaluated at the shape that fits the lengths, then again at that which fits the outline. If single outlines
    # scatter by more than is stated, their noise is larger by that much (`Discrepancy.noise`). The capsules are one of
    # so many `halves`, which have the errors of the microscope in common.
    among = halves * len(session)
    pilots = initial_guesses(model, session, session.circumstances, np.arange(len(session)), bands=1)[0]
    made = whitened_at(model, session, pilots, among=among)
    if not made.outline:
        return made
    better = fitted(model, session, made)
    further = Discrepancy.of(session, made, better).noise
    nearer = np.where(better.settled[:, None], better.theta, pilots)
    return whitened_at(model, session, nearer, among=among, further=further)
