"""Silhouettes: L_a counts with the outline."""

from dataclasses import replace

import numpy as np
from sessions import drawn_session

from capsbayes import Surrogate
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import whitening
from capsbayes.diagnosis.session import Session


def test_what_is_left_of_a_silhouette_has_one_number_more():
    model = Surrogate.open("square-neo-hookean", view="silhouette")
    drawn, _ = drawn_session(model, 6, seed=1, outline=True, noise=1e-4)
    silhouettes = [replace(each, outline=replace(each.outline, view="silhouette")) for each in drawn.measurements]
    session = Session(silhouettes, drawn.experiment)
    fits = fitted(model, session, whitening(model, session))
    assert fits.settled.all()
    for left, seen in zip(fits.residuals, session.measurements, strict=True):
        assert len(left) == len(seen.outline.points) + (seen.axial_length is not None)
    assert np.isfinite(fits.misfit).all()
