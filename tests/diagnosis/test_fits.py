"""Fits of many capsules: the truth without noise, as much left over as there is noise, errors that are true."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sessions import drawn_session

from capsbayes.diagnosis.fits import _to_try_again, fitted
from capsbayes.diagnosis.scores import whitening
from capsbayes.diagnosis.session import Session
from capsbayes.effects import Halo, catalogue


@pytest.mark.parametrize("outline", [False, True])
def test_without_noise_the_truth_is_found(model, outline):
    session, truth = drawn_session(model, 12, seed=1, outline=outline, noise=1e-6)
    fits = fitted(model, session, whitening(model, session))
    assert fits.settled.all()
    np.testing.assert_allclose(fits.theta[:, 0], truth["log_ca"], atol=5e-3 if outline else 5e-2)
    np.testing.assert_allclose(fits.size, truth["size_ratio"], atol=1e-3)


def test_the_viscosity_of_a_capsule_goes_into_its_modulus(model):
    session, _ = drawn_session(model, 6, seed=1, outline=False)
    usual = session.mean("viscosity")
    own = [usual, usual, 2.0 * usual, 2.0 * usual, usual, usual]
    each = [replace(one, conditions={"viscosity": mu}) for one, mu in zip(session.measurements, own, strict=True)]
    before, after = (
        fitted(model, one, whitening(model, one)).log_modulus for one in (session, Session(each, session.experiment))
    )
    np.testing.assert_allclose(after - before, np.log(np.array(own) / usual), atol=1e-9)


@pytest.mark.parametrize("outline", [False, True])
def test_errors_and_misfits_are_those_of_the_noise(model, outline):
    """Deviations from the truth, over their standard errors: mean 0, variance 1; the misfit is chi-squared."""
    session, truth = drawn_session(model, 150, seed=2, outline=outline)
    fits = fitted(model, session, whitening(model, session))
    assert fits.settled.mean() > 0.98
    done = fits.settled
    score = (fits.log_modulus - truth["log_modulus"])[done] / np.sqrt(fits.covariance[done, 0, 0])
    assert abs(score.mean()) < 4.0 / np.sqrt(len(score))
    assert 0.8 < score.std() < 1.2
    if outline:
        over = fits.misfit[done].sum() / fits.freedom[done].sum()
        assert over == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / fits.freedom[done].sum()) + 0.03)
    else:
        assert np.median(fits.misfit) < 1e-3


def test_the_size_of_an_effect_lowers_the_misfit_where_it_is_true(model):
    session, _ = drawn_session(model + Halo(), 30, seed=3, outline=True, sizes={"halo": 0.4e-6})
    white = whitening(model, session)
    misfits = [
        fitted(model + Halo(), session, white, {"halo": size}).misfit.sum() for size in (0.0, 0.2e-6, 0.4e-6, 0.6e-6)
    ]
    assert int(np.argmin(misfits)) == 2
    assert misfits[0] - misfits[2] > 50.0


def test_capsules_far_from_the_model_are_fitted_with_the_effect_that_they_have(model):
    """Their shapes without it are on the other side of the snap-through."""
    inflation = catalogue()["pre_inflation"]
    sizes = {"pre_inflation": 0.1}
    session, truth = drawn_session(model + inflation, 12, seed=6, outline=True, sizes=sizes)
    white = whitening(model, session)
    without, fits = fitted(model, session, white), fitted(model + inflation, session, white, sizes)
    assert without.ill.sum() > 6
    fitted(model + catalogue()["swelling"], session, white, {"swelling": 5.0})  # sought from elsewhere too, in vain
    assert np.median(white.pilots[:, 0] - truth["log_ca"]) < -0.5
    assert not fits.ill.any()
    score = (fits.log_modulus - truth["log_modulus"]) / np.sqrt(fits.covariance[:, 0, 0])
    assert np.abs(score).max() < 4.0


def test_halves_are_disjoint_and_alike(model):
    session, _ = drawn_session(model, 41, seed=4)
    first, second = session.halves(seed=5)
    assert sorted([*first, *second]) == list(range(41))
    extent = np.array([one.axial_extent for one in session.measurements])
    assert abs(extent[first].mean() - extent[second].mean()) < 0.2 * extent.std()
    again, _ = Session(session.measurements, session.experiment).halves(seed=5)
    np.testing.assert_array_equal(again, first)


def test_fits_do_not_depend_on_where_they_begin(model):
    session, _ = drawn_session(model + Halo(), 20, seed=5, outline=True, sizes={"halo": 0.4e-6})
    white, sizes = whitening(model, session), {"halo": 0.5e-6}
    first = fitted(model + Halo(), session, white, sizes)
    other = fitted(model + Halo(), session, white, sizes, first.theta + np.array([0.02, 0.001]), everywhere=False)
    errors = np.sqrt(np.diagonal(first.covariance, axis1=1, axis2=2))
    away = np.abs(np.stack([other.log_modulus - first.log_modulus, other.size - first.size], axis=1))
    assert np.quantile(away / errors, 0.9) < 1e-4


@pytest.mark.parametrize(
    ("misfit", "left", "expected"),
    [
        ([1.0, 1.9, 2.1, 1.0, np.inf], [0.0, 0.0, 0.0, 0.0, 0.0], [2, 4]),
        ([0.2, 0.3, 1.2, 0.2, 0.25], [0.0, 0.0, 0.0, 0.0, 0.0], [2]),  # 1.2 is much where the noise is overstated
        ([9.0, 9.0, 9.0, 9.0, 9.0], [0.0, 0.0, 0.0, 0.0, 0.0], [0, 1, 2, 3, 4]),
        ([1.0, 1.0, 1.0, 1.0, 1.0], [0.0, 0.2, 0.0, np.nan, 0.0], [1, 3]),  # not settled
    ],
)
def test_a_fit_worse_than_noise_or_most_others_is_sought_from_elsewhere(misfit, left, expected):
    freedom = np.full(5, 30)
    places = SimpleNamespace(square=np.array(misfit) * freedom, left=np.array(left))
    assert _to_try_again(places, freedom).tolist() == expected
