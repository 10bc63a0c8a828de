"""The flow rate as a second source of the mean velocity: wrong velocities, flow rates and widths are seen by it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capsbayes import Session
from capsbayes.database import Database
from capsbayes.diagnosis import Verdict, diagnose, find
from capsbayes.diagnosis.blind import TRUE_EFFECTS, Lab, draw_session
from capsbayes.diagnosis.finding import FLOW
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import log_likelihood, whitening
from capsbayes.effects import (
    ChannelSwelling,
    FlowRateError,
    HalfWidthApart,
    HalfWidthError,
    Halo,
    PictureRotation,
    PixelScale,
    VelocityScale,
)
from capsbayes.model import FixedParameters
from capsbayes.report.study import opening
from capsbayes.testing import check_effect

POOL = Path(__file__).parents[2] / "data" / "pools" / "none-0.nc"
EXACT = Lab(flow_rate_error=0.0, half_width_error=0.0)
ROUGH = Lab(flow_rate_error=0.01, half_width_error=0.25e-6)
FAULTS = {
    "velocity_scale": (VelocityScale(), 0.05, 5.0),
    "flow_rate_error": (FlowRateError(), 0.05, -5.0),
    "half_width_error": (HalfWidthError(), 0.03, 9.0),
}


@pytest.fixture(scope="module")
def shapes():
    return Database.read(POOL)


def drawn(shapes, effect="none", size=0.0, lab=EXACT, seed=1):
    return draw_session(shapes, TRUE_EFFECTS[effect], size, lab=lab, capsules=40, seed=seed, outline=False).session


def offset(finding):
    return next(deviation for deviation in finding.deviations if deviation.name == FLOW)


def test_a_right_session_has_velocities_as_its_flow_rates_say(shapes, model):
    found = offset(find(model, drawn(shapes), seed=1))
    assert abs(found.sigma) < 3.0
    assert abs(found.size) < 1.0  # per cent: 1 % a capsule, forty of them


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_shifts_them_and_its_effect_takes_the_shift_back(shapes, model, name):
    effect, size, shift = FAULTS[name]
    right, wrong = (offset(find(model, session, seed=1)) for session in (drawn(shapes), drawn(shapes, name, size)))
    assert wrong.size - right.size == pytest.approx(shift, abs=0.5)
    assert wrong.p_value < 1e-3
    extended = FixedParameters(model + effect, {name: size})
    assert offset(find(extended, drawn(shapes, name, size), seed=1)).size == pytest.approx(right.size, abs=0.3)


def test_the_error_of_the_flow_rate_is_common_to_all(shapes, model):
    """It does not average away with the number of capsules, in the deviation and in the likelihood alike."""
    session = drawn(shapes, lab=replace(ROUGH, half_width_error=0.5e-6))  # 1 % of Q, 4 % of l^2
    assert offset(find(model, session, seed=1)).error == pytest.approx(4.1, abs=0.2)
    exact = fitted(model, drawn(shapes, "velocity_scale", 0.05), whitening(model, session))
    rough = replace(exact, flow=replace(exact.flow, shared=np.full(40, 0.041)))
    none = replace(exact, flow=replace(exact.flow, offset=np.zeros(40)))
    lost = {
        kind: (log_likelihood(none) - log_likelihood(fits)).sum()
        for kind, fits in {"exact": exact, "rough": rough}.items()
    }
    assert lost["exact"] > 100.0
    assert lost["rough"] < 30.0  # the scatter of the offsets is left


@pytest.mark.parametrize("name", [*FAULTS, "half_width_apart"])
def test_an_effect_is_likelier_at_its_true_size(shapes, model, name):
    effects = {key: effect for key, (effect, _, _) in FAULTS.items()} | {"half_width_apart": HalfWidthApart()}
    size = 0.03 if name == "half_width_apart" else FAULTS[name][1]
    session = drawn(shapes, name, size)
    white = whitening(model, session)
    plain = log_likelihood(fitted(model, session, white)).sum()
    found = log_likelihood(fitted(model + effects[name], session, white, {name: size})).sum()
    assert found > plain + 20.0


def test_the_flow_rate_separates_a_wrong_pixel_from_a_swollen_channel(shapes, model):
    theta = {"capillary_number": np.array([0.05]), "size_ratio": np.array([0.9]), "flow_rate": np.array([1e-11])}
    theta |= {"capsule_velocity": np.array([5e-3])}
    pixel = (model + PixelScale()).relative_area(theta | {"pixel_scale": np.array([0.02])})
    swollen = (model + ChannelSwelling()).relative_area(theta | {"swelling": np.array([4.0])})
    assert (pixel[0], swollen[0]) == pytest.approx((1.0, 1.02**2))
    session = drawn(shapes, "pixel_scale", 0.025)
    white = whitening(model, session)
    pixel, swollen = (
        log_likelihood(fitted(model + effect, session, white, {effect.parameter.name: size})).sum()
        for effect, size in ((PixelScale(), 0.025), (ChannelSwelling(), 0.025 / 4.7e-3))
    )
    assert pixel > swollen + 20.0


@pytest.mark.parametrize("effect", [VelocityScale(), FlowRateError(), HalfWidthError(), HalfWidthApart()])
def test_effects_on_the_flow_keep_their_promises_on_other_effects(model, effect):
    check_effect(effect, model + Halo() + PictureRotation())


def test_without_flow_rates_they_are_not_testable(shapes, model):
    session = drawn(shapes, "velocity_scale", 0.05, replace(EXACT, flow_rate_error=None))
    study = diagnose(session, model, seed=1)
    assert study.verdict is Verdict.NONE
    assert "velocity scale" in study.not_testable
    assert "Not testable with these data, as no flow rates are stated: velocity scale" in " ".join(opening(study))
    assert not any(deviation.name == FLOW for deviation in study.finding.deviations)


def test_a_wrong_velocity_is_named_or_in_a_set_with_what_would_separate_it(shapes, model):
    effects = {key: effect for key, (effect, _, _) in FAULTS.items()}
    study = diagnose(drawn(shapes, "velocity_scale", 0.05), model, seed=1, candidates=effects)
    assert study.verdict is Verdict.AMBIGUOUS
    assert {*study.names} == {*FAULTS}
    assert study.scores["velocity_scale"].size == pytest.approx(0.05, abs=0.01)
    told = {"velocity_scale": (0.05, 0.005)}
    again = diagnose(study.session, model, seed=1, candidates=effects, measured=told, earlier=study)
    assert again.verdict is Verdict.NAMED
    assert again.name == "velocity scale"


def test_capsules_of_which_some_have_no_flow_rate_are_compared_as_far_as_they_go(shapes, model):
    session = drawn(shapes, "velocity_scale", 0.05)
    half = [replace(seen, flow_rate=None, flow_rate_error=None) for seen in session.measurements[:20]]
    found = offset(find(model, Session([*half, *session.measurements[20:]], session.experiment), seed=1))
    assert found.size == pytest.approx(5.0, abs=1.5)
