"""The table of two effects of the membrane is that of what was computed, and their sum is worse."""

import json

import numpy as np
import pytest

from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, covered
from evidence.benchmarks import membrane_effects, membrane_pools

PAIRS = membrane_pools.stored("pairs")
BOTH = "pre-inflation, strain hardening"


@pytest.fixture(scope="module")
def counts():
    return json.loads(membrane_effects.STORED.read_text())


def test_pairs_are_those_drawn():
    drawn = np.array([membrane_pools.drawn_pair(number) for number in range(membrane_pools.PAIRS)])
    stored = np.concatenate([PAIRS["values"], PAIRS["not_reached"]])
    np.testing.assert_allclose(np.sort(stored, axis=0), np.sort(drawn, axis=0), rtol=1e-12)
    assert covered(drawn).all()
    assert np.all(np.sum(drawn[:, 2:] != NULL_VALUES[2:], axis=1) == 2)
    assert np.all(np.ptp(drawn[:, :2], axis=0) > [0.05, 0.15])


def test_the_page_shows_the_stored_table(counts):
    shown = membrane_effects.PAGE.read_text().partition(membrane_effects.BEGIN)[2].partition(membrane_effects.END)[0]
    assert shown == membrane_effects.table(counts)
    assert all(2 * row["capsules"] > row["of"] for row in counts.values())


def test_pre_inflation_and_hardening_do_not_add_up(counts):
    for name, row in counts.items():
        if name == BOTH or name.startswith(membrane_effects.ALL_FOUR):
            added, together = (row[way] for way in membrane_effects.WAYS)
            assert together["rms"] < 0.4 * added["rms"]
            assert together["score"] < 1.0 < 2.0 < added["score"]
            assert together["gap"] < 0.5 * added["gap"]


def test_a_capsule_is_compared_both_ways():
    inflated, hardened = (FREE_PARAMETERS.index(name) for name in ("pre_inflation", "strain_hardening"))
    strength = PAIRS["values"][:, inflated] * PAIRS["values"][:, hardened]
    row = int(np.argmax(np.where(PAIRS["values"][:, 0] < 0.07, strength, 0.0)))
    found = membrane_effects.errors(*(PAIRS[key][row] for key in ("values", "numbers", "profile")))
    assert abs(found["together"][0]) < 0.5 * abs(found["added up"][0])
    assert found["together"][2] < found["added up"][2]
    assert found["together"][1] > 0.0


def test_a_capsule_beyond_the_joint_states_is_not_compared():
    values = np.array([0.06, 0.9, 0.02, 3.0, 0.0, 2e-3])
    model = membrane_effects.models(("pre_inflation", "bending"))["together"]
    shape = model.at(capillary_number=0.06, size_ratio=0.9, pre_inflation=0.02, bending=2e-3, outline=True)
    assert membrane_effects.errors(values, shape.values[0], shape.outline[0]) is None
