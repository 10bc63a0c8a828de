"""Rows from the tabulated model are those of the exact engine, capsule by capsule."""

import numpy as np
import pytest
from polynomial_model import PolynomialModel
from scipy import stats

from capsbayes.experiment import Experiment
from capsbayes.infer import Prior, Quadrature
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.many.tabulated.pyramid import Pyramid
from capsbayes.infer.many.tabulated.row_kernel import QUANTITIES
from capsbayes.infer.many.tabulated.rows import lengths_rows
from capsbayes.infer.many.tabulated.search import FAR, FOUND, UNRESOLVED
from capsbayes.infer.verdict import leanings
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity

MODEL = PolynomialModel()
EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.2e-6), viscosity=Quantity(0.85, 0.02))
TYPICAL = Measurement(2.14, 0.01, 5e-3, 5e-5, axial_length=1.81, axial_length_error=0.01)


@pytest.fixture(scope="module")
def pyramid():
    return Pyramid.of(MODEL)


def rows(measurements, pyramid, *, prior=None, experiment=EXPERIMENT, shifts=None):
    lengths = np.array(
        [
            [
                one.axial_extent,
                np.nan if one.axial_length is None else one.axial_length,
                one.covariance[0, 0],
                0.0 if one.axial_length is None else one.covariance[0, 1],
                0.0 if one.axial_length is None else one.covariance[1, 1],
            ]
            for one in measurements
        ]
    )
    velocities = np.array([[one.capsule_velocity, one.capsule_velocity_error] for one in measurements])
    inputs = Inputs.of_experiment(experiment)
    return lengths_rows(lengths, velocities, inputs, prior or Prior(), pyramid, shifts=shifts)


def exact(measurement, *, prior=None, experiment=EXPERIMENT):
    posterior = Quadrature(MODEL, experiment, prior)(measurement)
    return posterior, np.array([list(posterior.marginal(name).as_dict().values()) for name in QUANTITIES])


@pytest.mark.parametrize(
    "measurement",
    [
        TYPICAL,
        Measurement(2.14, 0.01, 5e-3, 5e-5),
        Measurement(2.14, 0.03, 5e-3, 1e-3, axial_length=1.81, axial_length_error=0.02, length_correlation=0.6),
        Measurement(1.95, 0.001, 2e-3, 2e-5, axial_length=1.8, axial_length_error=0.001),
    ],
    ids=["both lengths", "extent alone", "loose and correlated, velocity to 20 %", "sharp"],
)
def test_row_is_that_of_the_exact_engine(measurement, pyramid):
    found = rows([measurement], pyramid)
    posterior, wanted = exact(measurement)
    assert found.facts["end"][0] == FOUND
    away = np.abs(found.summaries[0] - wanted) / wanted[:, 1:2]
    assert away[:, :5].max() < 0.02
    assert away[:, 5:].max() < 0.05
    assert found.facts["log_evidence"][0] == pytest.approx(posterior.log_evidence, abs=0.01)


def test_general_distributions_and_a_uniform_modulus(pyramid):
    experiment = Experiment(cross_section="square", half_width=25e-6, viscosity=stats.gamma(30.0, scale=0.85 / 30.0))
    prior = Prior(Quantity.uniform(1e-3, 1.0), Quantity.log_uniform(1e-6, 1e-3))
    found = rows([TYPICAL], pyramid, prior=prior, experiment=experiment)
    wanted = exact(TYPICAL, prior=prior, experiment=experiment)[1]
    assert (np.abs(found.summaries[0] - wanted) / wanted[:, 1:2])[:, :5].max() < 0.02


def test_what_it_leans_on_is_what_the_draws_lean_on(pyramid):
    for extent in (2.14, 2.35, 2.42):
        one = Measurement(extent, 0.02, 5e-3, 5e-5)
        draws = exact(one)[0].drawn(np.random.default_rng(1), 20_000)
        wanted = leanings(draws, MODEL, Prior())["model"]
        assert rows([one], pyramid).facts["border"][0] == pytest.approx(wanted, abs=0.02)


def test_lengths_far_from_every_shape_and_lengths_too_sharp_are_distinguished(pyramid):
    far = Measurement(2.14, 0.01, 5e-3, 5e-5, axial_length=1.2, axial_length_error=0.01)
    sharp = Measurement(2.14, 1e-5, 5e-3, 5e-5, axial_length=1.81, axial_length_error=1e-5)
    without_error = PolynomialModel(error=1e-6)
    assert rows([far], pyramid).facts["end"][0] == FAR
    assert rows([sharp], Pyramid.of(without_error)).facts["end"][0] == UNRESOLVED


def test_a_prior_range_that_cuts_shows(pyramid):
    narrow = Prior(surface_shear_modulus=Quantity.log_uniform(1e-4, 0.041))
    assert rows([TYPICAL], pyramid).facts["within"][0] == pytest.approx(1.0)
    assert rows([TYPICAL], pyramid, prior=narrow).facts["within"][0] < 0.9


def test_own_viscosity_and_half_width_scale_what_follows_from_them(pyramid):
    plain, shifted = rows([TYPICAL], pyramid), rows([TYPICAL], pyramid, shifts=np.log([[2.0, 1.1]]))
    assert shifted.summaries[0, 0] == pytest.approx(2.0 * plain.summaries[0, 0])
    assert shifted.summaries[0, 1] == pytest.approx(1.1 * plain.summaries[0, 1])
    assert shifted.summaries[0, 3:] == pytest.approx(plain.summaries[0, 3:])


def test_the_mixture_has_the_moments_of_the_posterior_under_flat_priors(pyramid):
    """Log-uniform in both, so that the posterior is the likelihood of (log G_s, log a)."""
    flat = Prior(Quantity.log_uniform(1e-4, 10.0), Quantity.log_uniform(1e-6, 1e-3))
    known = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
    for one in (TYPICAL, Measurement(2.14, 0.01, 5e-3, 5e-4)):
        components = rows([one], pyramid, prior=Prior(), experiment=known).components[0]
        weights, means = components[:, 0], components[:, 1:3] + np.log([0.85, 25e-6])
        assert weights.sum() == pytest.approx(1.0)
        posterior = Quadrature(MODEL, known, flat)(one)
        for k, name in enumerate(("surface_shear_modulus", "capsule_radius")):
            wanted = posterior.log_marginal(name)
            mean = weights @ means[:, k]
            variance = weights @ (components[:, (3, 5)[k]] + (means[:, k] - mean) ** 2)
            assert mean == pytest.approx(wanted.mean, abs=0.01 * wanted.sd)
            assert np.sqrt(variance) == pytest.approx(wanted.sd, rel=0.01)
        draws = posterior.drawn(np.random.default_rng(2), 40_000)
        both = np.cov(np.log(draws["surface_shear_modulus"]), np.log(draws["capsule_radius"]))[0, 1]
        x, y = means.T
        of_mixture = weights @ (components[:, 4] + (x - weights @ x) * (y - weights @ y))
        assert of_mixture == pytest.approx(both, rel=0.05)
