"""Likelihood of fits against integrals over the shapes, and profiles of it against numbers worked out by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from capsbayes.diagnosis.scoring import Scores, log_likelihood, log_of_measured, population
from capsbayes.effects import catalogue

MISFIT = np.array([3.0, 9.5, 1.2, 6.0])
LOG_MODULUS = np.array([-3.0, -2.7, -3.2, -2.9])
ERRORS = np.array([[0.10, 0.010], [0.05, 0.004], [0.20, 0.012], [0.08, 0.009]])
CORRELATION = np.array([0.3, -0.5, 0.8, 0.0])


def fits(known):
    covariance = ERRORS[:, :, None] * ERRORS[:, None, :]
    covariance[:, 0, 1] *= CORRELATION
    covariance[:, 1, 0] *= CORRELATION
    return SimpleNamespace(known=np.array(known), misfit=MISFIT, log_modulus=LOG_MODULUS, covariance=covariance)


def test_it_is_the_integral_over_all_shapes_of_a_capsule_of_the_population():
    """Of misfits that are quadratic about the best shape, with a flat prior of the size; but for a factor 2 pi."""
    given = fits([True] * 4)
    people = population(LOG_MODULUS, ERRORS[:, 0] ** 2)
    assert people.spread > 0.01
    for i, found in enumerate(log_likelihood(given)):
        about = multivariate_normal([LOG_MODULUS[i], 0.0], given.covariance[i])
        top = about.pdf([LOG_MODULUS[i], 0.0])

        def over_sizes(log_modulus, i=i, about=about, top=top):
            def shape(size):
                return np.exp(-0.5 * MISFIT[i]) * about.pdf([log_modulus, size]) / top

            return quad(shape, -0.1, 0.1, points=[0.0])[0] * norm.pdf(log_modulus, people.mean, people.spread)

        likelihood = quad(over_sizes, LOG_MODULUS[i] - 1.5, LOG_MODULUS[i] + 1.5, points=[LOG_MODULUS[i]])[0]
        assert found == pytest.approx(np.log(likelihood) - np.log(2.0 * np.pi), abs=1e-5)


def test_the_population_is_the_likeliest():
    people = population(LOG_MODULUS, ERRORS[:, 0] ** 2)

    def likelihood(mean, spread):
        return norm.logpdf(LOG_MODULUS, mean, np.hypot(ERRORS[:, 0], spread)).sum()

    best = likelihood(people.mean, people.spread)
    for mean, spread in ((0.01, 0.0), (-0.01, 0.0), (0.0, 0.01), (0.0, -0.01)):
        assert likelihood(people.mean + mean, people.spread + spread) < best


def test_values_that_agree_within_their_errors_have_no_spread():
    people = population(np.array([1.0, 1.1, 0.9]), np.full(3, 0.04))
    assert people.spread == 0.0
    assert people.mean == pytest.approx(1.0)


def test_a_capsule_without_a_shape_is_less_likely_than_any_other():
    found = log_likelihood(fits([True, False, True, True]))
    assert found[1] == pytest.approx(found[[0, 2, 3]].min() - 15.0)
    assert np.all(log_likelihood(fits([True, False, False, False])) < -1e5)


@pytest.fixture
def scores():
    """A parabola with its top of 8 at 0.03 and a standard error of 0.01, shared equally by two capsules."""
    effect = catalogue()["pre_inflation"]
    sizes = np.linspace(0.0, 0.1, 201)
    total = 8.0 - 0.5 * ((sizes - 0.03) / 0.01) ** 2
    each = np.stack([0.25 * total, 0.75 * total], axis=1)
    return Scores(effect, sizes, each, np.zeros(len(sizes)), np.ones(len(sizes)))


def test_a_profile_has_its_best_size_its_intervals_and_its_ratio(scores):
    assert scores.size == pytest.approx(0.03)
    assert scores.interval() == pytest.approx((0.02, 0.04), abs=1e-6)
    assert scores.interval(1.92) == pytest.approx((0.03 - 0.01 * 3.84**0.5, 0.03 + 0.01 * 3.84**0.5), abs=1e-5)
    assert scores.log_likelihood_ratio == pytest.approx(4.5)
    assert scores.log_likelihood_ratios == pytest.approx([0.25 * 4.5, 0.75 * 4.5])


def test_its_evidence_is_the_likelihood_averaged_over_the_prior(scores):
    prior = scores.effect.prior
    mean = quad(
        lambda size: prior.pdf(size) * np.exp(4.5 - 0.5 * ((size - 0.03) / 0.01) ** 2), 0.0, 0.1, points=[0.03]
    )[0]
    assert scores.evidence == pytest.approx(np.log(mean / quad(prior.pdf, 0.0, 0.1)[0]), abs=1e-4)


def test_an_independent_measurement_is_a_normal_likelihood():
    assert log_of_measured(0.03, None) == 0.0
    assert log_of_measured(0.03, (0.02, 0.005)) == pytest.approx(-2.0)
    assert log_of_measured(0.01, (0.02, 0.005)) == pytest.approx(-2.0)
