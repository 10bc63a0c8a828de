"""Sobol indices compared with the error budget, and what becomes of samples without a shape."""

import json
from dataclasses import replace

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.infer import identify
from capsbayes.infer.posterior import deterministic_answer
from capsbayes.infer.prior import Inputs
from capsbayes.plan import error_budget, sobol_indices, varied_range
from capsbayes.plan.sobol import ANSWERS, Answerer
from capsbayes.status import Status


@pytest.fixture(scope="module")
def study(capsule, shipped, experiment):
    return sobol_indices(capsule, shipped, experiment, seed=3, samples=512)


def test_an_answer_is_the_deterministic_one(capsule, shipped, experiment):
    inputs = Inputs.of(capsule, experiment)
    answers, outside = Answerer(shipped, capsule, inputs, {})({"viscosity": np.array([0.85, 1.7])})
    expected = deterministic_answer(capsule, shipped, inputs).as_dict()
    for name in ANSWERS:
        assert answers[name][0] == pytest.approx(expected[name]), name
    assert answers["surface_shear_modulus"][1] == pytest.approx(2.0 * expected["surface_shear_modulus"])
    assert not outside.any()


def test_the_flow_rate_takes_the_place_of_the_velocity(capsule, shipped, experiment):
    rate = {"flow_rate": 1.2e-11, "flow_rate_error": 1.2e-13}
    seen = replace(capsule, **rate, capsule_velocity=None, capsule_velocity_error=np.nan)
    inputs = Inputs.of(seen, experiment)
    answers, _ = Answerer(shipped, seen, inputs, {})({"flow_rate": np.array([1.2e-11, 2.4e-11])})
    expected = deterministic_answer(seen, shipped, inputs).as_dict()
    assert answers["surface_shear_modulus"] == pytest.approx(expected["surface_shear_modulus"] * np.array([1.0, 2.0]))
    assert "flow_rate" in sobol_indices(seen, shipped, experiment, seed=1, samples=8).ranges


def test_lengths_without_a_shape_get_the_answer_of_the_nearest(capsule, shipped, experiment):
    inputs = Inputs.of(capsule, experiment)
    answerer = Answerer(shipped, capsule, inputs, {"axial_extent": 0.02, "axial_length": 0.02})
    answers, outside = answerer({"axial_length": np.array([1.81, 2.3, 0.9])})
    assert outside.tolist() == [False, True, True]
    assert shipped.domain.contains(answers["capillary_number"], answers["size_ratio"]).all()
    assert np.isfinite(answers["surface_shear_modulus"]).all()


def test_small_errors_give_the_shares_of_the_budget(study, capsule, shipped, experiment):
    budget = error_budget(identify(capsule, shipped, experiment, engine="quadrature", seed=1), shipped)
    for quantity in ("surface_shear_modulus", "capsule_radius"):
        for name, index in study.indices[quantity].items():
            share = budget[name].share[quantity]
            assert index.first == pytest.approx(share, abs=0.05 + index.first_error), (quantity, name)
            assert index.total == pytest.approx(share, abs=0.05 + index.total_error), (quantity, name)
    assert (study.outside, study.change, study.status) == (0, 0.0, Status.DONE)
    assert study.samples == 512 * 7
    assert study.indices["surface_shear_modulus"]["viscosity"].total > 0.05
    for answer in ("capsule_radius", "capillary_number", "size_ratio"):
        assert study.indices[answer]["viscosity"].total == pytest.approx(0.0, abs=1e-12)


def test_ranges_beyond_the_database_are_counted_and_said(capsule, shipped, experiment):
    wide = {"axial_length": "1.5 .. 2.25"}
    study = sobol_indices(capsule, shipped, experiment, seed=3, samples=128, ranges=wide)
    assert 0.1 < study.outside / study.samples < 0.9
    assert study.status is Status.RANGES_LEAVE_DATABASE
    assert study.change > 0.0
    assert study.indices["size_ratio"]["axial_length"].first > 0.9
    stored = json.loads(json.dumps(study.as_dict()))
    assert stored["ranges"]["axial_length"] == {"kind": "uniform", "first": 1.5, "second": 2.25}


def test_the_same_seed_gives_the_same_indices(study, capsule, shipped, experiment):
    again = sobol_indices(capsule, shipped, experiment, seed=3, samples=512)
    assert again.as_dict() == study.as_dict()
    table = study.table("capsule_radius")
    assert table.loc["half_width", "first"] == study.indices["capsule_radius"]["half_width"].first


def test_what_cannot_be_answered_is_refused(capsule, shipped, model, experiment):
    with pytest.raises(InputError, match="both lengths"):
        sobol_indices(replace(capsule, axial_length=None, axial_length_error=None), shipped, experiment, seed=1)
    with pytest.raises(InputError, match="a power of two"):
        sobol_indices(capsule, shipped, experiment, seed=1, samples=100)
    with pytest.raises(InputError, match="a database of"):
        sobol_indices(capsule, model, experiment, seed=1)
    with pytest.raises(InputError, match="ranges: colour: expected one of viscosity"):
        sobol_indices(capsule, shipped, experiment, seed=1, ranges={"colour": "1 .. 2"})


def test_a_range_is_read_in_any_unit():
    assert varied_range("24.5..25.5 um", "half_width").low == pytest.approx(24.5e-6)
    assert varied_range("6.2 +/- 0.06 mm/s", "capsule_velocity").error == pytest.approx(6e-5)
    assert varied_range("1.7 .. 1.9", "axial_length").sd == pytest.approx(0.2 / 12**0.5)


def test_lengths_in_metres_are_shown_in_micrometres(capsule, shipped, experiment):
    lengths = ("axial_extent", "axial_extent_error", "axial_length", "axial_length_error")
    metres = replace(capsule, over_half_width=False, **{name: 25e-6 * getattr(capsule, name) for name in lengths})
    ranges = sobol_indices(metres, shipped, experiment, seed=1, samples=8).ranges
    assert ranges["axial_extent"].shown("axial_extent") == "53.5 +/- 0.25 µm"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("viscosity", "0.9 .. 0.8 Pa s", "--range: viscosity: expected low < high"),
        ("viscosity", "0.8 .. 0.9 m", "--range: viscosity: expected a text in Pa s"),
        ("viscosity", "0.8 Pa s", "--range: viscosity: expected a range like"),
        ("colour", "1 .. 2", "--range: colour: expected one of viscosity, half_width"),
        ("half_width", "1 +/- 0.5 um", "--range: half_width: expected a range"),
    ],
)
def test_a_mistake_is_one_line(name, text, message):
    with pytest.raises(InputError, match=message) as caught:
        varied_range(text, name, where="--range")
    assert "\n" not in str(caught.value)
