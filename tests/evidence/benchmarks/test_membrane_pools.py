"""Capsules with random membranes are stored as drawn, and measured and compared as the benchmarks do."""

import numpy as np
import pytest
from scipy import stats

from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, RANGES, covered
from capsbayes.profile import Profile
from capsbayes.testing import check_law
from evidence.benchmarks import membrane_coverage, membrane_effects, membrane_pools

CAPSULES = membrane_pools.stored("capsules")
PAIRS = membrane_pools.stored("pairs")


def test_capsules_are_those_drawn():
    count = len(CAPSULES["values"]) + len(CAPSULES["not_reached"])
    drawn = [membrane_pools.drawn_capsule(number) for number in range(count)]
    stored = np.concatenate([CAPSULES["values"], CAPSULES["not_reached"]])
    assert covered(np.array(drawn)).all()
    np.testing.assert_allclose(np.sort(stored, axis=0), np.sort(drawn, axis=0), rtol=1e-12)


def test_membranes_are_drawn_from_the_default_priors():
    """Their parameters do not change where states are sought but for inflation and hardening, which do a little."""
    drawn = np.array([membrane_pools.drawn_values(np.random.default_rng(seed)) for seed in range(1000)])
    for column, (low, high) in enumerate(RANGES[2:], start=2):
        values = drawn[:, column]
        share = np.log(values / low) / np.log(high / low) if column in (3, 5) else (values - low) / (high - low)
        assert stats.kstest(share, "uniform").statistic < (0.06 if column in (3, 5) else 0.15)


def test_outlines_have_the_lengths_that_are_stored():
    for outline, numbers in zip(CAPSULES["profile"], CAPSULES["numbers"], strict=True):
        assert Profile.from_outline(outline).axial_extent == pytest.approx(numbers[0], abs=0.02)


def test_the_members_of_a_batch_share_a_membrane_and_flow_at_four_rates():
    batch = membrane_pools.Batch.drawn(3)
    members = [next(batch.capsules(member)) for member in range(membrane_pools.MEMBERS)]
    values = np.array([values for values, _ in members])
    assert covered(values).all()
    assert np.all(values[:, 2:] == batch.values[2:])
    moduli, factors = (np.array([of_it[key] for _, of_it in members]) for key in ("relative_modulus", "flow_factor"))
    np.testing.assert_allclose(values[:, 0] * moduli / factors, batch.values[0], rtol=1e-12)
    assert sorted(set(factors)) == pytest.approx(list(batch.factors))
    assert 0.5 * batch.modulus_spread < np.log(moduli).std() < 1.5 * batch.modulus_spread


def test_capsules_of_other_laws_have_their_moduli_and_no_hardening():
    others, laws = membrane_pools.stored("others"), list(membrane_pools.OTHER_LAWS.values())
    for number, law in enumerate(laws[: int(others["law"].max()) + 1]):
        values = others["values"][others["law"] == number]
        assert len(values) > 0.7 * membrane_pools.OF_EACH
        assert np.all(values[:, 3] == law.area_dilation_modulus)
        assert np.all(np.isnan(values[:, 4]))
        _, truth = membrane_coverage.measured(
            "lengths", values[0], others["numbers"][0], others["profile"][0], np.random.default_rng(0)
        )
        assert "strain_hardening" not in truth


@pytest.mark.parametrize("law", membrane_pools.OTHER_LAWS.values(), ids=membrane_pools.OTHER_LAWS)
def test_other_laws_are_laws(law):
    check_law(law)


@pytest.mark.parametrize("kind", ["capsules", "batches"])
def test_every_tenth_is_simulated_on_a_finer_mesh(kind):
    numbers = membrane_pools.numbers_of(kind)
    assert sorted(numbers[12] + numbers[16]) == list(range(10 * len(numbers[16])))
    assert len(numbers[16]) >= 4


def test_the_batches_of_all_meshes_lie_where_states_are_sought():
    for number in range(len(membrane_pools.OF_MESHES)):
        batch = membrane_pools.Batch.of_meshes(number)
        assert covered(np.array([next(batch.capsules(member))[0] for member in range(membrane_pools.FEW)])).all()
        assert covered((batch.values * np.array([batch.factors[-1], 1, 1, 1, 1, 1]))[None])[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", membrane_coverage.KINDS)
def test_a_capsule_is_identified_from_its_errors(kind):
    row, capsule = next(iter(membrane_coverage.capsules().items()))
    seen, truth = membrane_coverage.measured(kind, *capsule, np.random.default_rng([7, row]))
    assert abs(seen.axial_extent - capsule[1][0]) < 5 * membrane_coverage.LENGTH_ERROR
    found = membrane_coverage.identified(kind, "unknown", row, capsule)
    assert not found["refused"]
    assert found["truth"] == truth
    interval = found["found"]["surface_shear_modulus"]
    assert interval["lower_95"] < interval["median"] < interval["upper_95"]
    assert truth["capsule_radius"] == pytest.approx(found["found"]["capsule_radius"]["median"], rel=0.1)


def test_pairs_are_those_drawn():
    drawn = np.array([membrane_pools.drawn_pair(number) for number in range(membrane_pools.PAIRS)])
    stored = np.concatenate([PAIRS["values"], PAIRS["not_reached"]])
    np.testing.assert_allclose(np.sort(stored, axis=0), np.sort(drawn, axis=0), rtol=1e-12)
    assert covered(drawn).all()
    assert np.all(np.sum(drawn[:, 2:] != NULL_VALUES[2:], axis=1) == 2)
    assert np.all(np.ptp(drawn[:, :2], axis=0) > [0.05, 0.15])


def test_a_capsule_is_compared_both_ways():
    inflated, hardened = (FREE_PARAMETERS.index(name) for name in ("pre_inflation", "strain_hardening"))
    strength = PAIRS["values"][:, inflated] * PAIRS["values"][:, hardened]
    row = int(np.argmax(np.where(PAIRS["values"][:, 0] < 0.07, strength, 0.0)))
    found = membrane_effects.errors(*(PAIRS[key][row] for key in ("values", "numbers", "profile")))
    assert abs(found["together"][0]) < 0.5 * abs(found["added up"][0])
    assert found["together"][2] < found["added up"][2]
    assert found["together"][1] > 0.0


def test_a_capsule_beyond_the_joint_states_is_not_compared():
    values = np.array([0.02, 0.9, 0.015, 3.0, 0.5, 2e-4])
    model = membrane_effects.models(("pre_inflation", "strain_hardening"))["together"]
    shape = model.at(capillary_number=0.02, size_ratio=0.9, pre_inflation=0.015, strain_hardening=0.5, outline=True)
    assert membrane_effects.errors(values, shape.values[0], shape.outline[0]) is None
