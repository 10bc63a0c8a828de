import numpy as np
import pytest
from density_of_all_inputs import DensityOfAllInputs

from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.infer.quadrature import Quadrature
from capsbayes.infer.sampling import Effort, LogDensity, sampled


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


def test_the_same_seed_gives_the_same_chains_and_another_other_ones(model, experiment, capsule):
    effort = Effort(walkers=16, steps=60, budget=60)
    one, same, other = (
        sampled(density_of(model, experiment, capsule), seed=seed, effort=effort).coordinates for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert one.shape != other.shape or not np.array_equal(one, other)


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
