import warnings
from dataclasses import replace

import numpy as np
import pytest
from density_of_all_inputs import DensityOfAllInputs

from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.infer.quadrature import Quadrature
from capsbayes.infer.sampling import (
    Effort,
    LogDensity,
    autocorrelation_time,
    bulk_ess,
    sampled,
    split_rhat,
    starting_points,
    tail_ess,
)
from capsbayes.prediction import Prediction


def density_of(model, experiment, seen, kind=LogDensity):
    return kind(model, PosteriorDensity.of(seen, Inputs.of(seen, experiment), Prior()))


def test_a_run_that_has_every_input_as_a_coordinate_agrees_with_the_grid(model, experiment, capsule):
    """Nothing is integrated by hand here: the factored posterior and its grid are checked from outside."""
    density = density_of(model, experiment, capsule, DensityOfAllInputs)
    chains = sampled(density, seed=3, effort=Effort(walkers=48, steps=900, budget=900))
    draws = chains.named()
    modulus = draws["viscosity"] * draws["capsule_velocity"]
    points = model({name: np.ravel(draws[name]) for name in ("capillary_number", "size_ratio")})
    flow_ratio = points.velocity_ratio.reshape(modulus.shape)
    draws = draws | {"surface_shear_modulus": modulus / draws["capillary_number"] / flow_ratio}
    draws["capsule_radius"] = draws["size_ratio"] * draws["half_width"]
    exact = Quadrature(model, experiment)(capsule)
    for name in ("surface_shear_modulus", "capsule_radius", "capillary_number", "viscosity", "half_width"):
        one, values = exact.log_marginal(name), np.log(draws[name])
        assert values.mean() == pytest.approx(one.mean, abs=0.05 * one.sd)
        assert values.std() == pytest.approx(one.sd, rel=0.03)


def test_a_run_ends_at_its_budget_with_the_gates_that_failed(model, experiment, capsule):
    chains = sampled(density_of(model, experiment, capsule), seed=1, effort=Effort(walkers=16, steps=40, budget=90))
    assert chains.steps + chains.burn_in == 90
    assert any(not gate.passed for gate in chains.gates)


def test_a_run_is_doubled_while_it_is_not_enough(model, experiment, capsule):
    lengths = []

    def enough(chains):
        lengths.append(chains.steps + chains.burn_in)
        return len(lengths) == 2

    sampled(density_of(model, experiment, capsule), seed=1, effort=Effort(walkers=48), enough=enough)
    assert lengths[1] >= 2 * lengths[0]


def test_thinning_keeps_every_walker(model, experiment, capsule):
    chains = sampled(density_of(model, experiment, capsule), seed=1, effort=Effort(walkers=16, steps=200, budget=200))
    thin = chains.thinned()
    assert thin.coordinates.shape[1:] == chains.coordinates.shape[1:]
    assert len(thin.coordinates) <= len(chains.coordinates) // 2
    assert thin.log_density.shape == thin.coordinates.shape[:3]


@pytest.mark.parametrize("name", ["capsule", "capsule_in_metres"])
def test_inputs_sampled_or_integrated_differ_by_their_own_densities(model, experiment, name, request):
    """At fixed inputs the two densities over the shape differ by a constant."""
    seen = request.getfixturevalue(name)
    shapes = np.array([[np.log(0.07), 0.95], [np.log(0.082), 0.96], [np.log(0.09), 0.97]])
    integrated = density_of(model, experiment, seen)
    width = np.full((3, 1), 25.05e-6)
    few = np.hstack([shapes, width]) if len(integrated.names) == 3 else shapes
    every = np.hstack([shapes, np.tile([0.84, 25.05e-6, 5.01e-3], (3, 1))])
    difference = integrated(few) - density_of(model, experiment, seen, DensityOfAllInputs)(every)
    np.testing.assert_allclose(difference, difference[0], atol=1e-8)


def test_outside_the_domain_is_impossible_and_not_counted(model, experiment, capsule):
    density = density_of(model, experiment, capsule)
    np.testing.assert_array_equal(density(np.array([[np.log(0.5), 0.96], [np.log(0.08), 2.0]])), -np.inf)
    assert density.not_a_number == 0
    every = density_of(model, experiment, capsule, DensityOfAllInputs)
    assert every(np.array([[np.log(0.08), 0.96, -0.8, 25e-6, 5e-3]]))[0] == -np.inf


def test_not_a_number_inside_the_domain_is_impossible_and_counted(model, experiment, capsule):
    class Broken:
        name, sha256, domain = "broken", "", model.domain

        def __call__(self, theta, *, outline=False):
            prediction = model(theta)
            covariance = np.where(prediction.axial_extent[:, None, None] > 2.0, np.nan, prediction.covariance)
            fields = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio")
            return Prediction(
                *(getattr(prediction, name) for name in fields), covariance=covariance, inside=prediction.inside
            )

    density = density_of(Broken(), experiment, capsule)
    values = density(np.array([[np.log(0.08), 0.96], [np.log(0.08), 0.80], [np.log(0.5), 0.96]]))
    assert np.isneginf(values[[0, 2]]).all()
    assert np.isfinite(values[1])
    assert density.not_a_number == 1


@pytest.mark.parametrize("name", ["capsule", "capsule_in_metres", "capsule_from_the_side"])
@pytest.mark.parametrize("kind", [LogDensity, DensityOfAllInputs])
def test_all_walkers_start_at_finite_density_and_none_twice(model, experiment, name, kind, request):
    density = density_of(model, experiment, request.getfixturevalue(name), kind)
    starts = starting_points(density, 4, 32, np.random.default_rng(18))
    assert starts.shape == (4, 32, len(density.names))
    flat = starts.reshape(128, -1)
    assert np.all(np.isfinite(density(flat)))
    assert len(np.unique(flat, axis=0)) == 128


def test_starts_are_found_around_a_narrow_posterior_and_wider_than_it(model, experiment, capsule):
    seen = replace(capsule, axial_extent_error=1e-3, axial_length_error=1e-3)
    starts = starting_points(density_of(model, experiment, seen), 4, 64, np.random.default_rng(19)).reshape(-1, 2)
    exact = Quadrature(model, experiment)(seen)
    for k, name in enumerate(("capillary_number", "size_ratio")):
        values = np.exp(starts[:, k]) if k == 0 else starts[:, k]
        one = exact.marginal(name)
        assert abs(values.mean() - one.mean) < one.sd
        assert 1.0 < values.std() / one.sd < 4.0


def test_a_density_that_vanishes_everywhere_is_said(model, experiment, capsule):
    density = density_of(model, experiment, capsule)
    density.__class__ = type("Nowhere", (LogDensity,), {"__call__": lambda self, x: np.full(len(x), -np.inf)})
    with pytest.raises(ValueError, match="no point of the model's domain"):
        starting_points(density, 4, 32, np.random.default_rng(20))


def autoregressive(rng, shape, memory):
    """Stationary first-order process along the last axis: autocorrelation time (1 + m) / (1 - m)."""
    noise = rng.standard_normal(shape)
    draws = np.empty(shape)
    draws[..., 0] = noise[..., 0]
    for k in range(1, shape[-1]):
        draws[..., k] = memory * draws[..., k - 1] + np.sqrt(1.0 - memory**2) * noise[..., k]
    return draws


@pytest.fixture(scope="module")
def arviz():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its next version once a day
        import arviz
    return arviz


@pytest.mark.parametrize("memory", [0.0, 0.7, 0.95, -0.4])
def test_effective_sample_sizes_are_those_of_arviz(arviz, memory):
    draws = np.exp(autoregressive(np.random.default_rng(8), (8, 1000), memory))
    assert bulk_ess(draws) == pytest.approx(float(arviz.ess(draws, method="bulk")), rel=1e-2)
    assert tail_ess(draws) == pytest.approx(float(arviz.ess(draws, method="tail")), rel=1e-2)


def test_rhat_is_that_of_arviz_when_ensembles_have_one_walker(arviz):
    draws = autoregressive(np.random.default_rng(9), (4, 800), 0.8)
    draws[0] += 0.3
    ours = split_rhat(draws.T[:, :, None])
    assert ours == pytest.approx(float(arviz.rhat(draws, method="z_scale")), rel=1e-6)
    assert ours > 1.01


def test_rhat_sees_an_ensemble_elsewhere_but_not_a_single_walker():
    rng = np.random.default_rng(10)
    draws = rng.standard_normal((500, 4, 16))
    assert split_rhat(draws) < 1.002
    one_walker = draws.copy()
    one_walker[:, 0, 0] += 1.0
    assert split_rhat(one_walker) < 1.01
    draws[:, 2] += 0.5
    assert split_rhat(draws) > 1.01


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_the_autocorrelation_time_of_a_known_process(memory):
    draws = autoregressive(np.random.default_rng(11), (64, 4000), memory)
    assert autocorrelation_time(draws.T) == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.06)


def test_the_autocorrelation_time_is_that_of_emcee():
    from emcee.autocorr import integrated_time

    draws = autoregressive(np.random.default_rng(12), (32, 2000), 0.8).T
    assert autocorrelation_time(draws) == pytest.approx(float(integrated_time(draws[..., None])[0]), rel=0.02)


def test_a_constant_has_as_many_draws_as_it_has():
    assert bulk_ess(np.tile(np.arange(100.0), (4, 1))) > 0.0
    assert tail_ess(np.ones((4, 100))) == 400.0
