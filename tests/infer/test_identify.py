import importlib
from dataclasses import replace

import numpy as np
import pytest
from polynomial_model import FoldedModel, PolynomialModel
from scipy.stats import uniform

from capsbayes.effects import Halo
from capsbayes.errors import InputError
from capsbayes.infer import Posterior, Prior, identify
from capsbayes.infer.sampling import Effort
from capsbayes.quantity import Quantity
from capsbayes.report.posterior import budget_sentence
from capsbayes.status import Status


@pytest.fixture(scope="module")
def posterior(model, experiment, capsule):
    return identify(capsule, model, experiment, seed=1)


def test_the_default_engine_finds_the_capsule_and_agrees_with_quadrature(posterior):
    assert posterior.engine == "emcee"
    assert posterior.status is Status.DONE
    assert posterior.agreement.passed
    assert all(gate.passed for gate in posterior.gates), [str(gate) for gate in posterior.gates]
    assert len(posterior.gates) == 13  # ten of the chains; two p-values and the Reynolds number
    assert posterior.marginals["capillary_number"].contains(0.082, level=68)
    assert posterior.marginals["size_ratio"].contains(0.96, level=68)
    modulus = 0.85 * 5e-3 / 1.29 / 0.082
    assert posterior.marginals["surface_shear_modulus"].contains(modulus, level=68)
    assert posterior.marginals["capsule_radius"].contains(24e-6, level=68)


def test_an_answer_without_error_budget_is_the_same_else(posterior, model, experiment, capsule, tmp_path):
    found = identify(capsule, model, experiment, seed=1, error_budget=False)
    assert not found.shares
    assert found.marginals == posterior.marginals
    assert "was not computed" in budget_sentence(found)
    found.write(tmp_path / "posterior.nc")
    assert not Posterior.read(tmp_path / "posterior.nc").shares
    assert not found.summary().empty


def test_draws_are_labelled_by_walker_and_ensemble(posterior):
    chains, draws = posterior.draws["surface_shear_modulus"].shape
    assert chains == len(posterior.ensemble) == 256
    assert draws >= 100
    assert set(posterior.ensemble) == {0, 1, 2, 3}
    np.testing.assert_allclose(
        posterior.draws["surface_shear_modulus"] * posterior.draws["capillary_number"],
        posterior.draws["viscosity"] * posterior.draws["mean_velocity"],
    )


def test_the_same_seed_gives_the_same_posterior_and_another_another(model, experiment, capsule):
    effort = Effort(walkers=16, steps=60, budget=60)
    one, again, other = (
        identify(capsule, model, experiment, seed=seed, effort=effort).draws["surface_shear_modulus"]
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert one.shape != other.shape or np.all(one != other)


def test_lengths_in_metres(model, experiment, capsule_in_metres):
    found = identify(capsule_in_metres, model, experiment, seed=2)
    assert found.status is Status.DONE
    assert found.marginals["capsule_radius"].contains(24e-6, level=68)


def test_too_little_sampling_is_said(model, experiment, capsule):
    found = identify(capsule, model, experiment, seed=1, effort=Effort(walkers=16, steps=40, budget=40))
    assert found.status is Status.NOT_MIXED
    assert not all(gate.passed for gate in found.gates)


class WithCaveat(PolynomialModel):
    """The same model, with another stable shape or with wrinkles up to a Ca."""

    def __init__(self, kind):
        super().__init__()
        self.kind = kind

    def caveats(self, theta):
        return {self.kind: theta["capillary_number"] < 0.1}


@pytest.mark.parametrize(
    ("kind", "status", "words"),
    [
        ("two shapes", Status.LEANS_ON_TWO_SHAPES, "started from rest"),
        ("wrinkles", Status.LEANS_ON_WRINKLES, "wrinkles about the axis"),
        ("unsure shapes", Status.LEANS_ON_UNSURE_SHAPES, "no better than 5 %"),
    ],
)
def test_a_posterior_where_the_model_has_a_caveat_says_so(experiment, capsule, kind, status, words):
    found = identify(capsule, WithCaveat(kind), experiment, seed=1, engine="quadrature")
    assert found.status is status
    assert words in str(found.status)
    assert found.leaning[kind] > 0.5


def test_a_posterior_cut_by_the_domain_leans_on_it(model, experiment, capsule_from_the_side):
    for engine in ("emcee", "quadrature"):
        found = identify(capsule_from_the_side, model, experiment, seed=1, engine=engine)
        assert found.status is Status.LEANS_ON_BORDER
        assert found.leaning["model"] > 0.05


def test_a_posterior_cut_by_its_prior_leans_on_it(model, experiment, capsule):
    prior = Prior(surface_shear_modulus=Quantity.log_uniform(1e-4, 0.041))
    found = identify(capsule, model, experiment, seed=1, prior=prior)
    assert found.status is Status.LEANS_ON_PRIOR
    assert found.agreement.passed
    assert found.marginals["surface_shear_modulus"].upper_95 < 0.0415


def test_a_sampler_that_is_too_narrow_is_caught_by_quadrature(model, experiment, capsule, monkeypatch):
    """Chains drawn in by 7 %, as a wrong proposal does."""
    module = importlib.import_module("capsbayes.infer.identify")
    honest = module.sampled

    def narrow(*args, **keywords):
        chains = honest(*args, **{**keywords, "enough": lambda chains: True})
        middle = chains.coordinates.mean(axis=(0, 1, 2))
        return replace(chains, coordinates=middle + 0.93 * (chains.coordinates - middle))

    monkeypatch.setattr(module, "sampled", narrow)
    found = identify(capsule, model, experiment, seed=1)
    assert found.status is Status.ENGINES_DISAGREE
    assert found.agreement.sd > 0.03


def test_wrong_arguments_are_refused(model, experiment, capsule):
    with pytest.raises(InputError, match="identify: engine: expected emcee or quadrature, got 'gibbs'"):
        identify(capsule, model, experiment, seed=1, engine="gibbs")

    class Tube(type(model)):
        cross_section = "circular"

    for tube in (Tube(), Tube() + Halo(), (Tube() + Halo()).fixed(halo=0.0)):
        expected = 'experiment: cross_section: expected "circular", that of the model, got "square"'
        with pytest.raises(InputError, match=expected):
            identify(capsule, tube, experiment, seed=1)
    with pytest.raises(InputError, match="prior: pre_inflaton: expected a coordinate of manufactured polynomial"):
        identify(capsule, model, experiment, seed=1, prior=Prior(coordinates={"pre_inflaton": uniform(0.0, 0.1)}))
    with pytest.raises(InputError, match="expected a shape that a case of"):
        identify(replace(capsule, axial_extent=4.0), model, experiment, seed=1)


def test_two_modes_are_weighed_by_both_engines_or_said(experiment, capsule):
    seen = replace(capsule, axial_extent=2.10, axial_length=1.80, axial_extent_error=0.004, axial_length_error=0.004)
    found = identify(seen, FoldedModel(), experiment, seed=1, effort=Effort(doublings=0, budget=1500))
    exact = found.reference["capillary_number"]
    assert found.status in (Status.DONE, Status.ENGINES_DISAGREE, Status.NOT_MIXED)
    if found.status is Status.DONE:
        assert found.marginals["capillary_number"].mean == pytest.approx(exact.mean, abs=0.1 * exact.sd)
    assert exact.sd > 0.5 * exact.mean
