"""Effects drawn by the operators that look for them are named, or not told from those that look alike.

This is the least to ask: an effect that is hidden by the simulator, or drawn by other code, is harder.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from sessions import EXPERIMENT, drawn_session

from capsbayes import MembraneSurrogate, Session, Surrogate
from capsbayes.diagnosis.diagnosis import Verdict, diagnose, summary
from capsbayes.effects import Halo, MotionBlur, PixelScale, catalogue
from capsbayes.model import FixedParameters
from capsbayes.report.study import explanation_table

CAPSULES = 40
OPTICAL = {one.parameter.name: one for one in (Halo(), MotionBlur(), PixelScale())}


def session_with(model, name, size, *, seed=7):
    effect = catalogue()[name]
    return drawn_session(model + effect, CAPSULES, seed=seed, outline=True, sizes={name: size})[0]


def test_a_right_model_misses_nothing(model):
    session, _ = drawn_session(model, 16, seed=11, outline=True)
    study = diagnose(session, model, seed=3)
    assert study.verdict is Verdict.NONE
    assert study.model is model
    assert str(study).startswith("no disagreement was found")


def test_a_few_capsules_tell_nothing(model):
    session, _ = drawn_session(model, 6, seed=11, outline=True)
    study = diagnose(session, model, seed=3)
    assert study.verdict is Verdict.NOT_TESTABLE
    stored = json.loads(json.dumps(summary(study), allow_nan=False))
    assert (stored["candidates"], stored["held_out"], stored["finding"]["deviations"]) == ([], None, [])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), [("exposure", 3e-4), ("pre_inflation", 0.02)])
def test_a_clear_effect_is_named_and_measured(model, name, size):
    study = diagnose(session_with(model, name, size), model, seed=3)
    assert (study.verdict, study.names) == (Verdict.NAMED, (name,))
    assert study.sizes[name] == pytest.approx(size, rel=0.25)
    assert study.verification.before.p_value < 0.01 < study.verification.after.p_value
    assert study.verification.log_likelihood_ratio > 3.0 * study.verification.error
    assert study.verification.p_value < 1e-4
    ((by_first, by_second),) = study.verification.sizes
    assert by_first == pytest.approx(by_second, rel=0.5)
    assert by_first != by_second
    assert catalogue()[name].name in str(study)
    assert study.model.name == f"{model.name} + {catalogue()[name].name}"
    assert study.name == catalogue()[name].name
    assert study.gap[1] < study.gap[0]


@pytest.mark.slow
def test_bending_comes_first_where_another_section_is_not_ruled_out(model):
    """A few capsules make most of the difference between the two, so that it may be chance."""
    study = diagnose(session_with(model, "bending", 1.5e-3), model, seed=3)
    assert study.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert study.names[0] == "bending"
    assert set(study.names) <= {"bending", "section_aspect"}
    assert study.scores["bending"].size == pytest.approx(1.5e-3, rel=0.25)


@pytest.mark.slow
def test_look_alikes_are_not_distinguished(model):
    """A scale of all lengths and a halo differ by how they change with the size of a capsule, and hardly here."""
    study = diagnose(session_with(model, "pixel_scale", 0.012, seed=8), model, seed=3, candidates=OPTICAL)
    assert study.verdict is Verdict.AMBIGUOUS
    assert {("pixel_scale",), ("halo",)} <= {*study.in_question}
    assert study.model is model


@pytest.mark.slow
def test_a_measurement_made_elsewhere_distinguishes_look_alikes(model):
    session, bead = session_with(model, "pixel_scale", 0.012, seed=8), {"halo": (0.0, 5e-8)}
    study = diagnose(session, model, seed=3, candidates=OPTICAL, measured=bead)
    assert study.in_question == (("pixel_scale",),)
    assert study.scores["pixel_scale"].size == pytest.approx(0.012, rel=0.25)
    scale = {"pixel_scale": (0.013, 0.002)}
    study = diagnose(session, model, seed=3, candidates=OPTICAL, measured=scale)
    assert (study.verdict, study.names) == (Verdict.NAMED, ("pixel_scale",)), "what was measured needs no threshold"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "cross_section", "name", "size"),
    [
        (
            lambda: MembraneSurrogate.open("square").fixed(area_dilation_modulus=1.5),
            "square",
            "area_dilation_modulus",
            1.5,
        ),
        (lambda: Surrogate.open("circular-skalak"), "circular", "strain_hardening", 1.0),
    ],
    ids=("area dilation modulus", "hardening in a tube"),
)
def test_the_membrane_is_named_from_the_states_over_all_its_parameters(truth, cross_section, name, size):
    drawn, known = drawn_session(truth(), CAPSULES, seed=5, outline=True)
    session = Session(drawn.measurements, replace(EXPERIMENT, cross_section=cross_section))
    study = diagnose(session, Surrogate.open(f"{cross_section}-neo-hookean"), seed=1)
    assert (study.verdict, study.names) == (Verdict.NAMED, (name,))
    assert study.sizes[name] == pytest.approx(size, rel=0.25)
    before, after = (comparison.median_modulus for comparison in study.verification.comparisons)
    due = np.exp(np.median(known["log_modulus"]))
    assert abs(np.log(after / due)) < 0.15 < abs(np.log(before / due))


@pytest.mark.slow
def test_two_effects_are_found_together(model):
    sizes = {"pixel_scale": 0.025, "rest_aspect": 1.075}
    candidates = {name: catalogue()[name] for name in ("halo", *sizes)}
    both = model + candidates["rest_aspect"] + candidates["pixel_scale"]
    session, known = drawn_session(both, CAPSULES, seed=9, outline=True, sizes=sizes)
    study = diagnose(session, model, seed=3, candidates=candidates)
    assert (study.verdict, study.something_else) == (Verdict.AMBIGUOUS, True), "two are the best of many pairs"
    (names,) = (each for each in study.in_question if {*each} == {*sizes})
    modulus, last = study.surface_shear_modulus, study.scores_of(names)[-1]
    assert modulus.low < np.exp(np.median(known["log_modulus"])) < modulus.high
    assert modulus.median == pytest.approx(last.modulus[last.best], rel=0.05), "what both change is counted once"
    for scores in study.scores_of(names):
        low, high = scores.interval(1.92)
        assert low < sizes[scores.effect.parameter.name] < high
    assert sum(study.probabilities.values()) == pytest.approx(1.0)
    assert " and ".join(names) in study.probabilities
    both_known = {"pixel_scale": (0.026, 0.003), "rest_aspect": (1.07, 0.01)}
    again = diagnose(session, model, seed=3, candidates=candidates, measured=both_known, earlier=study)
    assert (again.verdict, {*again.names}) == (Verdict.NAMED, {*sizes})


@pytest.mark.slow
def test_once_more_is_measured_a_study_goes_on_with_what_was_computed(model):
    session = session_with(model, "pixel_scale", 0.012, seed=8)
    first = diagnose(session, model, seed=3, candidates=OPTICAL)
    bead = {"halo": (0.0, 5e-8)}
    again = diagnose(session, model, seed=3, candidates=OPTICAL, measured=bead, earlier=first)
    anew = diagnose(session, model, seed=3, candidates=OPTICAL, measured=bead)
    assert (again.verdict, again.names) == (anew.verdict, anew.names)
    assert again.scores["pixel_scale"].size == pytest.approx(anew.scores["pixel_scale"].size, rel=0.02)
    with pytest.raises(ValueError, match="the same session"):
        diagnose(session, model, seed=4, candidates=OPTICAL, earlier=first)


@pytest.mark.slow
def test_an_effect_that_no_candidate_explains_is_unknown(model):
    study = diagnose(session_with(model, "pre_inflation", 0.03), model, seed=3, candidates=OPTICAL)
    assert study.verdict is Verdict.UNKNOWN
    assert study.model is model


def test_without_any_candidate_the_modulus_is_that_with_something_else(model):
    study = diagnose(session_with(model, "pre_inflation", 0.03), model, seed=3, candidates={})
    assert study.verdict is Verdict.UNKNOWN
    found = study.surface_shear_modulus
    assert 0.0 < found.low < found.median < found.high


def test_a_model_with_held_sizes_is_that_at_these_sizes(model):
    theta = {"capillary_number": np.array([0.03, 0.07]), "size_ratio": np.array([0.85, 0.9])}
    held = FixedParameters(model + PixelScale(), {"pixel_scale": 0.02})
    due = (model + PixelScale())(theta | {"pixel_scale": np.full(2, 0.02)})
    np.testing.assert_array_equal(held(theta).values, due.values)
    assert held.sha256 != FixedParameters(model + PixelScale(), {"pixel_scale": 0.01}).sha256
    assert (held + Halo()).name == "square-neo-hookean + pixel scale + halo"


def test_what_nothing_can_show_is_not_called_ruled_out(model):
    hidden = {"pixel_scale": 0.03}
    tried = {name: catalogue()[name] for name in (*hidden, "exposure", "viscosity_error")}
    session, _ = drawn_session(model + tried["pixel_scale"], 20, seed=7, outline=True, sizes=hidden)
    study = diagnose(session, model, seed=3, candidates=tried)
    assert study.names == ("pixel_scale",)
    table, rest = explanation_table(study)
    assert dict(zip(table["effect"], table["probability"], strict=True))["viscosity"] == "cannot be tested"
    assert not rest


@pytest.mark.slow
def test_an_effect_far_likelier_than_none_is_looked_for_without_a_significant_deviation(model):
    study = diagnose(session_with(model, "pixel_scale", 0.03), model, seed=3, candidates=OPTICAL, level=1e-9)
    assert study.finding.p_value > study.level
    assert "pixel_scale" in study.names
    assert study.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
