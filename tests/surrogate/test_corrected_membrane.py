"""The corrected surrogate over the membrane agrees with the finer databases, and with simulations better than sums."""

import numpy as np
import pytest

from capsbayes import Surrogate
from capsbayes.effects import SIMULATED, Halo
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES
from capsbayes.parameters import OF_THE_MEMBRANE
from capsbayes.profile import vertex_normals
from capsbayes.testing import check_model
from evidence.benchmarks import membrane_pools

CAPSULES = {"capillary_number": np.array([0.045, 0.06, 0.08]), "size_ratio": np.array([0.82, 0.9, 0.95])}
PAIR = {"pre_inflation": 0.03, "strain_hardening": 0.6}
FINER = {"pre_inflation": 0.03, "strain_hardening": 0.6, "bending": 2e-3}


@pytest.fixture(scope="module")
def plain():
    return Surrogate.open("square-neo-hookean")


@pytest.fixture(scope="module")
def model(plain):
    return plain.with_membrane()


def seen(model, outline=True, **membrane):
    return model(CAPSULES | {name: np.full(3, value) for name, value in membrane.items()}, outline=outline)


def test_it_keeps_the_contract_of_models(model):
    check_model(model)
    check_model(model.fixed(**PAIR))
    assert model.with_membrane() is model


def test_the_plain_membrane_is_that_of_the_plain_database(plain, model):
    null = dict(zip(FREE_PARAMETERS[2:], NULL_VALUES[2:], strict=True))
    np.testing.assert_array_equal(seen(model, **null).outline, seen(plain).outline)


@pytest.mark.parametrize(("name", "value"), FINER.items())
def test_one_parameter_is_that_of_its_own_database(name, value, model):
    due = Surrogate.open(f"square-{name.replace('_', '-')}")
    one, other = seen(model, **{name: value}), seen(due, **{name: value})
    np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_array_equal(one.outline, other.outline)
    point = {"capillary_number": 0.06, "size_ratio": 0.9, name: value}
    np.testing.assert_array_equal(model.outline_modes(**point), due.outline_modes(**point))


@pytest.mark.parametrize("other", OF_THE_MEMBRANE)
@pytest.mark.parametrize("name", OF_THE_MEMBRANE)
def test_nothing_jumps_where_a_second_parameter_begins_to_differ(name, other, model):
    if name == other:
        return
    known = {"area_dilation_modulus": 2.0, "bending": 6e-4, **PAIR}
    null = NULL_VALUES[FREE_PARAMETERS.index(other)]
    alone, both = seen(model, **{name: known[name]}), seen(model, **{name: known[name], other: null + 1e-9})
    np.testing.assert_allclose(both.outline, alone.outline, atol=2e-5)
    errors = [np.sqrt(np.einsum("nii->ni", found.covariance)) for found in (alone, both)]
    np.testing.assert_allclose(errors[1], errors[0], atol=1e-3)


def test_a_batch_of_different_membranes_is_each_by_itself(model):
    inflations, hardenings = np.array([0.0, 0.03, 0.03]), np.array([0.0, 0.0, 0.6])
    together = model(CAPSULES | {"pre_inflation": inflations, "strain_hardening": hardenings}, outline=True)
    for row, membrane in enumerate(({}, {"pre_inflation": 0.03}, PAIR)):
        alone = seen(model, **membrane)
        np.testing.assert_allclose(together.values[row], alone.values[row], rtol=1e-12)
        np.testing.assert_allclose(together.covariance[row], alone.covariance[row], rtol=1e-9)
        np.testing.assert_allclose(together.outline[row], alone.outline[row], rtol=1e-12)


def test_known_errors_are_weighted_as_by_kriging(model):
    """The closed form is that of the system of equations with the product of exponential correlations."""
    names = ("pre_inflation", "strain_hardening", "bending")
    values = np.array([[0.06, 0.9, 0.002, 3.0, 0.1, 3e-4]])
    weights, left = model._weights(names, values)
    away = np.array([model.joint.distances_from_plain(name, values[:, FREE_PARAMETERS.index(name)]) for name in names])
    assert np.all((away > 0.1) & (away < 3.0)), "near enough to count"
    points = np.concatenate([np.diag(away[:, 0]), np.zeros((1, 3))])
    among = np.exp(-np.abs(points[:, None] - points).sum(axis=2))
    towards = np.exp(-np.abs(points - away[:, 0]).sum(axis=1))
    due = np.linalg.solve(among, towards)
    np.testing.assert_allclose([weights[(name,)][0] for name in names] + [weights[()][0]], due, rtol=1e-9)
    np.testing.assert_allclose(left, 1.0 - towards @ due, rtol=1e-9)


def test_simulated_pairs_are_nearer_than_the_sum_of_both_effects(plain, model):
    pairs = membrane_pools.stored("pairs")
    theta = dict(zip(FREE_PARAMETERS, pairs["values"].T, strict=True))
    normals = vertex_normals(pairs["profile"])

    def distance(outlines):
        return np.sqrt(np.mean(np.sum((outlines - pairs["profile"]) * normals, axis=-1) ** 2, axis=1))

    flow = {name: theta[name] for name in FREE_PARAMETERS[:2]}
    without = plain(flow, outline=True).outline
    alone = [model(flow | {name: theta[name]}, outline=True).outline - without for name in OF_THE_MEMBRANE]
    together, added = distance(model(theta, outline=True).outline), distance(without + sum(alone))
    both = np.isfinite(together) & np.isfinite(added)
    assert both.sum() > 30
    assert np.median(together[both]) < 0.8 * np.median(added[both])
    assert np.sqrt(np.mean(together[both] ** 2)) < 0.7 * np.sqrt(np.mean(added[both] ** 2))


def test_effects_are_computed_together_in_any_order_and_between_others(plain, model):
    due = seen(model, **PAIR)
    one, other = (SIMULATED[name] for name in PAIR)
    for both in (plain + one + other, plain + other + one, (plain + one).fixed(pre_inflation=0.03) + other):
        given = {name: value for name, value in PAIR.items() if name in both.names}
        np.testing.assert_allclose(seen(both, **given).outline, due.outline, rtol=1e-12)
        point = {"capillary_number": 0.06, "size_ratio": 0.9}
        np.testing.assert_allclose(both.outline_modes(**point, **given), model.outline_modes(**point, **PAIR))
    halo = {"halo": 0.5e-6, "half_width": 25e-6}
    between, after = (
        seen(plain + one + Halo() + other, **PAIR, **halo),
        seen(plain + one + other + Halo(), **PAIR, **halo),
    )
    np.testing.assert_allclose(between.outline, after.outline, rtol=1e-12)
    np.testing.assert_allclose(between.axial_extent, due.axial_extent + 0.04, atol=1e-12)


def test_other_simulated_effects_are_added_to_the_membrane(plain, model):
    corners, known = SIMULATED["corner_radius"], {**PAIR, "corner_radius": 0.1}
    one, other = (SIMULATED[name] for name in PAIR)
    change = seen(plain + corners, corner_radius=0.1).values - seen(plain).values
    for both in (plain + one + other + corners, plain + corners + one + other):
        np.testing.assert_allclose(seen(both, **known).values, seen(model, **PAIR).values + change, atol=1e-9)


def test_where_there_is_no_joint_state_the_changes_are_added_up(model):
    low = {"capillary_number": np.array([0.02]), "size_ratio": np.array([0.9])}
    inflated, hardened = {"pre_inflation": np.array([0.015])}, {"strain_hardening": np.array([0.5])}
    alone = [model(low | one).values for one in (inflated, hardened)]
    np.testing.assert_allclose(model(low | inflated | hardened).values, sum(alone) - model(low).values, atol=1e-12)
    assert not model.joint(low | inflated | hardened).inside[0]
    assert model.outline_modes(**{name: value[0] for name, value in (low | inflated | hardened).items()}).ndim == 2


def test_it_says_where_effects_are_added_up(plain):
    one, other, bending = (SIMULATED[name] for name in (*PAIR, "bending"))
    theta = {"capillary_number": np.array([0.02, 0.06]), "size_ratio": np.full(2, 0.9)}
    small = {"pre_inflation": np.full(2, 0.015), "strain_hardening": np.full(2, 0.5)}
    assert (plain + one + other).added_up(theta | small).tolist() == [True, False]
    held = (plain + one).fixed(pre_inflation=0.015) + Halo() + other
    assert held.added_up(theta | {"strain_hardening": np.full(2, 0.5)}).tolist() == [True, False]
    assert not (plain + one).added_up(theta | {"pre_inflation": np.full(2, 0.015)}).any()
    stiff = {"pre_inflation": np.full(2, 0.03), "bending": np.full(2, 2e-3)}
    assert not (plain + one + bending).added_up(theta | stiff).any()
    skalak = Surrogate.open("square-skalak")
    assert skalak.with_membrane() is None
    assert (skalak + one + bending).added_up(theta | stiff).all()
    assert not (skalak + one).added_up(theta | {"pre_inflation": np.full(2, 0.03)}).any()


def test_a_model_without_the_plain_membrane_takes_the_difference_of_effects(plain):
    skalak, dilation = Surrogate.open("square-skalak"), SIMULATED["area_dilation_modulus"]
    change = seen(plain + dilation, area_dilation_modulus=2.0).values - seen(plain).values
    added = seen(skalak + dilation, area_dilation_modulus=2.0)
    np.testing.assert_allclose(added.values, seen(skalak).values + change, atol=1e-12)
