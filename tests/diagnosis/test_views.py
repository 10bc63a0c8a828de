"""Sets of silhouettes: files keep what their outlines show, and L_a counts with them."""

from dataclasses import replace

import numpy as np
import pytest
from sessions import drawn_session

from capsbayes import Surrogate
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import whitening
from capsbayes.diagnosis.session import Session
from capsbayes.errors import InputError
from capsbayes.measurement_sets import read_netcdf, write_netcdf


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean", view="silhouette")


@pytest.fixture(scope="module")
def session(model):
    drawn, _ = drawn_session(model, 6, seed=1, outline=True, noise=1e-4)
    seen = [replace(one, outline=replace(one.outline, view="silhouette")) for one in drawn.measurements]
    return Session(seen, drawn.experiment)


def test_a_file_keeps_the_view(session, tmp_path):
    write_netcdf(tmp_path / "set.nc", session.measurements)
    again = read_netcdf(tmp_path / "set.nc", session.experiment)
    assert {one.outline.view for one in again.measurements} == {"silhouette"}


def test_a_file_holds_one_view(session, tmp_path):
    first, *others = session.measurements
    mixed = [replace(first, outline=replace(first.outline, view="mid-plane")), *others]
    with pytest.raises(InputError, match=r"outline\.view: expected outlines of one view, got mid-plane, silhouette"):
        write_netcdf(tmp_path / "set.nc", mixed)


def test_what_is_left_of_a_silhouette_has_one_number_more(model, session):
    fits = fitted(model, session, whitening(model, session))
    assert fits.settled.all()
    for left, seen in zip(fits.residuals, session.measurements, strict=True):
        assert len(left) == len(seen.outline.points) + (seen.axial_length is not None)
    assert np.isfinite(fits.misfit).all()
