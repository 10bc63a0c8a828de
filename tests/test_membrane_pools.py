"""Capsules with random membranes are stored as drawn, and the table of coverage is that of what was identified."""

import json

import membrane_batches
import membrane_coverage
import membrane_pools
import membrane_sensitivity
import numpy as np
import pytest
from scipy import stats

from capsbayes.membrane_database import RANGES, covered
from capsbayes.profile import Profile
from capsbayes.report.posterior import BEYOND_LAWS

CAPSULES = membrane_pools.stored("capsules")


@pytest.fixture(scope="module")
def counts():
    return json.loads(membrane_coverage.STORED.read_text())


def test_capsules_are_those_drawn():
    drawn = [
        membrane_pools.drawn_values(np.random.default_rng([membrane_pools.SEED, 0, number]))
        for number in range(len(CAPSULES["values"]) + len(CAPSULES["not_reached"]))
    ]
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


def test_the_page_shows_the_stored_counts(counts):
    page = membrane_coverage.PAGE.read_text()
    for pool, (before, after) in membrane_coverage.MARKS.items():
        assert before + membrane_coverage.table(counts[pool]) + after in page


def test_the_page_shows_what_batches_are_expected_to_tell_and_what_they_tell():
    stored = json.loads(membrane_sensitivity.STORED.read_text())
    before, after = membrane_sensitivity.MARKS
    page = membrane_sensitivity.PAGE.read_text()
    assert before + membrane_sensitivity.table(stored) + after in page
    before, after = membrane_sensitivity.SAME_MARKS
    same = json.loads(membrane_sensitivity.SAME.read_text())
    assert before + membrane_sensitivity.same_capsule_table(same) + after in page
    before, after = membrane_sensitivity.MAP_MARKS
    of_one = json.loads(membrane_sensitivity.MAP.read_text())
    assert before + membrane_sensitivity.map_table(of_one) + after in page
    assert of_one["model_sha256"] == membrane_coverage.model("unknown").sha256, "the map is of another model"
    expected, found = stored["lengths"]["surface_shear_modulus"][:2]
    assert found == pytest.approx(expected, rel=0.1)
    expected, found = stored["outline"]["surface_shear_modulus"][:2]
    assert expected < found < 1.6 * expected  # the goal of a tenth is missed, as the page says


def test_the_page_shows_what_batches_tell():
    stored = json.loads(membrane_batches.STORED.read_text())
    page, shown = membrane_batches.PAGE.read_text(), membrane_batches.tables(stored)
    for name, (before, after) in membrane_batches.MARKS.items():
        assert before + shown[name] + after in page
    assert f"{stored['tail']:g} of its standard deviations" in page


@pytest.mark.parametrize("kind", membrane_coverage.KINDS)
def test_intervals_with_the_membrane_unknown_hold_the_truth_as_often_as_they_say(counts, kind):
    row = counts["capsules"][f"{kind}, unknown"]
    used = row["capsules"] - row["refused"]
    assert used >= 20
    for quantity in membrane_coverage.QUANTITIES:
        for level in membrane_coverage.LEVELS:
            held = row[f"{quantity} {level}"]
            assert stats.binomtest(held, used, level / 100).pvalue > 1e-3, (quantity, level, held)


def test_the_default_is_wrong_about_other_membranes(counts):
    for kind in membrane_coverage.KINDS:
        row = counts["capsules"][f"{kind}, neo-Hookean"]
        assert row["surface_shear_modulus 95"] < 0.6 * (row["capsules"] - row["refused"])


def test_what_another_law_does_to_the_modulus_is_what_the_answer_says(counts):
    bias = counts["others"]["outline, generalised Hooke"]["bias"]
    assert round(float(np.expm1(bias)), 1) == BEYOND_LAWS


def test_capsules_of_other_laws_have_their_moduli_and_no_hardening():
    others = membrane_pools.stored("others")
    for number, law in enumerate(membrane_pools.OTHER_LAWS.values()):
        values = others["values"][others["law"] == number]
        assert len(values) > 0.7 * membrane_pools.OF_EACH
        assert np.all(values[:, 3] == law.area_dilation_modulus)
        assert np.all(np.isnan(values[:, 4]))
        _, truth = membrane_coverage.measured(
            "lengths", values[0], others["numbers"][0], others["profile"][0], np.random.default_rng(0)
        )
        assert "strain_hardening" not in truth


@pytest.mark.slow
@pytest.mark.parametrize("kind", membrane_coverage.KINDS)
def test_a_capsule_is_identified_from_its_errors(kind):
    row, capsule = next(iter(membrane_coverage.capsules().items()))
    seen, truth = membrane_coverage.measured(kind, *capsule, np.random.default_rng([7, row]))
    assert abs(seen.axial_extent - capsule[1][0]) < 5 * membrane_coverage.LENGTH_ERROR
    found = membrane_coverage.identified(kind, "unknown", seen, truth)
    assert not found["refused"]
    interval = found["found"]["surface_shear_modulus"]
    assert interval["lower_95"] < interval["median"] < interval["upper_95"]
    assert truth["capsule_radius"] == pytest.approx(found["found"]["capsule_radius"]["median"], rel=0.1)
