"""Odds of an effect over what is like it, compared with closed forms; names by sessions that are drawn anew."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sessions import drawn_session

from capsbayes import diagnose
from capsbayes.diagnosis import NOTHING, UNKNOWN, Verdict
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.odds import Calibration, Odds, _of_growth
from capsbayes.diagnosis.scores import Discrepancy, whitening
from capsbayes.diagnosis.search import Search
from capsbayes.effects import Halo, MotionBlur, PixelScale, catalogue

LENGTHENING = {
    name: catalogue()[name] for name in ("exposure", "pixel_aspect", "halo", "rest_aspect", "section_aspect")
}


class Weighed:
    """Everything that is weighed of a session."""

    def __init__(self, model, session, candidates):
        self.session, self.white = session, whitening(model, session)
        self.without = fitted(model, session, self.white)
        made = model, candidates, session, self.white, self.without
        self.search = Search(*made, {}, lambda step: None)
        self.trials = self.search.trials()
        self.explanations = self.search.explanations(self.trials)
        self.something_else = Discrepancy.of(session, self.white, self.without)
        self.odds = Odds.of(self.explanations, self.something_else, session, self.without)

    def calibration(self, visibility):
        changes = {names: each.change for names, each in self.explanations.items()}
        return Calibration.of(changes, visibility, self.something_else, self.white, self.without, self.session, 1)


@pytest.fixture(scope="module")
def blurred(model):
    session, _ = drawn_session(model + MotionBlur(), 30, seed=7, outline=True, sizes={"exposure": 5e-4})
    return Weighed(model, session, LENGTHENING)


def test_a_change_is_what_ca_and_the_size_do_not_absorb(blurred):
    change, fits = blurred.explanations[("exposure",)].change, blurred.trials["exposure"].fits
    row = min(change.seen)
    assert np.abs(fits.slopes[row].T @ change.seen[row]).max() < 1e-9 * np.abs(fits.slopes[row]).max()
    whole = blurred.without.misfit.sum() - fits.misfit.sum()
    assert change.visibility**2 == pytest.approx(whole, rel=0.3)
    assert change.cosine(change) == pytest.approx(1.0)
    assert 0.5 < change.cosine(blurred.explanations[("pixel_aspect",)].change) < 0.97


def test_a_size_that_grows_has_the_evidence_of_a_normal_growth():
    """With a deviate z of information I and a growth of variance g^2, z has the variance 1 + g^2 I."""
    for deviate, information in ((0.3, 40.0), (5.0, 40.0), (2.0, 0.1)):
        for growth, found in zip((0.15, 0.4), _of_growth(np.array(deviate), np.array(information)), strict=True):
            wide = 1.0 + growth**2 * information
            due = multivariate_normal(cov=wide).logpdf(deviate) - multivariate_normal(cov=1.0).logpdf(deviate)
            assert found == pytest.approx(due, rel=1e-9)


def test_a_right_size_does_not_grow_and_a_wrong_effect_does(blurred):
    velocity = np.log(blurred.session.circumstances["capsule_velocity"])
    right, wrong = (blurred.explanations[(name,)].change for name in ("exposure", "pixel_aspect"))
    assert abs(right.growth(velocity)[0]) < 2.5
    assert wrong.growth(velocity)[0] > 4.0


def test_the_errors_that_all_capsules_share_count_in_the_growth(blurred):
    change = blurred.explanations[("pixel_aspect",)].change
    velocity = np.log(blurred.session.circumstances["capsule_velocity"])
    none = change._replace(common={row: each[:0] for row, each in change.common.items()})
    known, shared = none.growth(velocity), change.growth(velocity)
    assert 0.0 < shared[0] < known[0]
    assert shared[1] < known[1]


def test_the_truth_is_likelier_than_what_is_like_it_and_all_probabilities_are_one(blurred):
    odds = blurred.odds
    assert odds.best == ("exposure",)
    assert odds.margin(odds.best) > 1.0 > odds.margin(("pixel_aspect",))
    assert sum(odds.probabilities.values()) == pytest.approx(1.0)
    assert set(odds.probabilities) == {*LENGTHENING, NOTHING, UNKNOWN}
    assert odds.like[("pixel_aspect",)] > odds.exact[("pixel_aspect",)]
    assert odds.alike[("exposure",)] == {("exposure",)}
    both = replace(odds, alike={**odds.alike, ("exposure",): frozenset({("exposure",), ("halo",)})})
    assert both.margin(("exposure",)) >= odds.margin(("exposure",))


def test_as_often_as_is_said_another_effect_gets_a_name(blurred):
    faint, clear = blurred.calibration(6.0), blurred.calibration(25.0)
    assert 0.0 <= faint.wrong <= 0.02
    assert faint.power < 0.6 < 0.8 < clear.power
    assert faint.threshold > clear.threshold >= 1.0
    assert blurred.calibration(0.5).threshold == np.inf


@pytest.fixture(scope="module")
def unexplained(model, blurred):
    """Motion blur, which is not tried, looks like oblong pixels, but more so at high velocities."""
    others = {name: each for name, each in LENGTHENING.items() if name != "exposure"}
    return diagnose(blurred.session, model, seed=1, candidates=others)


def test_an_effect_that_is_not_tried_gets_no_name(unexplained):
    assert unexplained.verdict in (Verdict.AMBIGUOUS, Verdict.UNKNOWN)
    assert unexplained.something_else or unexplained.verdict is Verdict.UNKNOWN
    assert unexplained.probabilities[UNKNOWN] > 0.5


def test_something_else_in_question_widens_the_modulus_however_improbable_it_is(unexplained):
    odds = unexplained.odds
    unlikely = replace(odds, other=odds.other - 60.0, like={name: log - 60.0 for name, log in odds.like.items()})
    sure, open_ = (replace(unexplained, odds=unlikely, something_else=open_) for open_ in (False, True))
    assert sure.probabilities == open_.probabilities
    assert sure.probabilities[UNKNOWN] < 1e-6
    widths = [np.log(study.surface_shear_modulus.high / study.surface_shear_modulus.low) for study in (sure, open_)]
    assert widths[1] > 1.2 * widths[0]


def test_probabilities_verdict_and_sentence_agree(model):
    """Of sessions with an effect of any size, or none."""
    candidates = {each.parameter.name: each for each in (Halo(), PixelScale(), MotionBlur())}
    for seed, size in enumerate((0.0, 1e-4, 2e-4, 4e-4)):
        session, _ = drawn_session(model + MotionBlur(), 16, seed=seed, outline=True, sizes={"exposure": size})
        study = diagnose(session, model, seed=1, candidates=candidates)
        known = study.probabilities
        if study.verdict is Verdict.NONE:
            assert known[NOTHING] > 1.0 / 21.0
            continue
        likeliest = max(known, key=lambda name: known[name])
        if study.verdict is Verdict.NAMED:
            assert likeliest == study.names[0]
        for names in study.in_question:
            assert known[" and ".join(names)] > known[likeliest] * np.exp(-5.0)
        assert study.something_else or known[UNKNOWN] < known[likeliest] * np.exp(-1.0)


def test_a_second_effect_shows_in_what_the_first_leaves(model):
    sizes = {"halo": 0.5e-6, "pixel_aspect": 1.03}
    both = model + LENGTHENING["halo"] + LENGTHENING["pixel_aspect"]
    session, _ = drawn_session(both, 30, seed=7, outline=True, sizes=sizes)
    found = Weighed(model, session, {name: LENGTHENING[name] for name in sizes}).explanations
    first = max(found, key=lambda names: found[names].log_evidence)
    (second,) = {(name,) for name in sizes} - {first}
    change = found[first].change
    assert change.beside(found[second].change) > 4.0
    assert change.beside(change) == 0.0


@pytest.mark.parametrize(
    ("apart", "where"),
    [
        (np.log(2.0) * (np.arange(40) % 2), "two kinds of capsules by ln G_s"),
        (np.linspace(0.0, 0.5, 40), "drift of ln G_s with time"),
    ],
    ids=["two batches", "a viscosity that drifts"],
)
def test_moduli_that_are_not_those_of_one_batch_are_no_effect_of_the_catalogue(model, apart, where):
    session, _ = drawn_session(model, 40, seed=5, outline=True, apart=apart)
    study = diagnose(session, model, seed=1, candidates=LENGTHENING)
    assert study.verdict is Verdict.UNKNOWN
    found = study.finding.table()
    assert found.loc[where, "p_value"] < 0.01
    assert found.drop(index=where)["p_value"].min() > 0.01
    assert abs(found.loc[where, "size"] - np.ptp(apart)) < 3.0 * found.loc[where, "error"]


def test_one_modulus_is_asked_of_velocity_size_and_viscosity(model):
    session, _ = drawn_session(model, 40, seed=5, outline=True)
    assert diagnose(session, model, seed=1, candidates={}).finding.one_modulus > 0.05
    apart = 0.5 * (np.arange(40) % 2)
    thinner = replace(
        session,
        measurements=tuple(
            replace(one, conditions={"viscosity": 0.8 * np.exp(by)})
            for one, by in zip(session.measurements, apart, strict=True)
        ),
    )
    finding = diagnose(thinner, model, seed=1, candidates={}).finding
    assert finding.one_modulus < 0.01
    assert finding.table().loc["trend of ln G_s with ln mu", "size"] == pytest.approx(1.0, abs=0.3)
