"""Evidences compared with closed forms and a dense second route."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sessions import drawn_session

from capsbayes import Surrogate
from capsbayes.diagnosis import NOTHING, UNKNOWN, Scores
from capsbayes.diagnosis.finding import find
from capsbayes.diagnosis.fits import fitted, whitening
from capsbayes.diagnosis.regions import _DISPLACED, Displacements, displaced_regions
from capsbayes.diagnosis.search import evidences
from capsbayes.effects import Halo, PixelScale


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


def scores_at(effect, sizes, totals):
    return Scores(effect, sizes, totals[:, None], np.zeros(len(sizes)), np.full(len(sizes), 0.05))


def test_evidence_of_a_gaussian_likelihood_with_a_gaussian_prior():
    """The mean of N(x; m, s) over a prior N(0, t) is N(m; 0, (s^2 + t^2)^1/2)."""
    effect, middle, error = Halo(), 0.3e-6, 0.1e-6
    sizes = np.linspace(-2.0, 2.0, 401) * 1e-6
    found = scores_at(effect, sizes, -0.5 * ((sizes - middle) / error) ** 2).evidence
    prior = effect.prior.sd
    wide = np.hypot(prior, error)
    due = np.log(error / wide) - 0.5 * (middle / wide) ** 2 + 0.5 * (middle / error) ** 2
    assert found == pytest.approx(due, abs=0.01)


def test_unknown_displacements_are_integrated_as_by_their_whole_covariance(model):
    session, _ = drawn_session(model, 5, seed=4, outline=True)
    white = whitening(model, session)
    fits = fitted(model, session, white)
    displaced = displaced_regions(white, fits)
    patterns = np.hstack([one.pattern for one in displaced])
    residuals = np.concatenate(fits.residuals)
    covariance = np.eye(len(residuals)) + _DISPLACED**2 * patterns.T @ patterns
    due = multivariate_normal(cov=covariance).logpdf(residuals) - multivariate_normal(
        cov=np.eye(len(residuals))
    ).logpdf(residuals)
    assert Displacements.of(displaced, fits).evidence == pytest.approx(due, rel=1e-6)
    first, second = (Displacements.of(part, fits) for part in (displaced[:2], displaced[2:]))
    assert (first + second).evidence == pytest.approx(due, rel=1e-6)
    assert Displacements().evidence == 0.0


def test_nothing_is_the_likeliest_where_nothing_is_gained(model):
    session, _ = drawn_session(model, 20, seed=4, outline=True)
    finding = find(model, session, seed=1)
    sizes = np.linspace(-0.05, 0.05, 101)
    flat = scores_at(PixelScale(), sizes, -0.5 * (sizes / 0.002) ** 2)
    found = evidences({"pixel_scale": flat}, finding)
    assert next(iter(found)) == NOTHING
    assert found[NOTHING] == 0.0
    assert found[UNKNOWN] < 0.0
    assert finding.leaves_nothing(0.01)
    assert not replace(finding, displacements=Displacements(np.eye(5) * 1e6, np.full(5, 1e5))).leaves_nothing(0.01)
