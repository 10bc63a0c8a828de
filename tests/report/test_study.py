"""The page of a study holds all that it promises, and nothing from elsewhere."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from printed import assert_same, plain
from sessions import drawn_session

from capsbayes import Surrogate, diagnose
from capsbayes.diagnosis import Session, Verdict
from capsbayes.diagnosis.finding import Pair
from capsbayes.diagnosis.odds import Calibration
from capsbayes.diagnosis.scores import Outcome, Trial
from capsbayes.effects import SIMULATED, Halo, MotionBlur
from capsbayes.model import FixedParameters
from capsbayes.profile import arc_share
from capsbayes.report import study_page, verdict_sentence
from capsbayes.report.study import caveats, explanation_table, opening, study_parts
from capsbayes.report.study_figures import chosen_capsules, outline_finding, trends
from capsbayes.report.tables import Strong, print_parts, typeset

BLUR = {"exposure": MotionBlur()}


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


@pytest.fixture(scope="module")
def study(model):
    """A few capsules, taken to disagree whatever they show."""
    sizes = {"exposure": 8e-4}
    session, _ = drawn_session(model + MotionBlur(), 14, seed=7, outline=True, sizes=sizes, settings=True)
    session = replace(session, left_out=("a.toml: expected this, got that",))
    return diagnose(session, model, seed=3, candidates=BLUR, level=1.0)


@pytest.fixture(scope="module")
def page(study):
    return study_page(study)


class Tags(HTMLParser):
    """What a page opens and does not close, and where it looks elsewhere."""

    def __init__(self, page):
        super().__init__()
        self.open, self.links = [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.links += [value for name, value in attributes if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def pictures(page):
    return [base64.b64decode(data).decode() for data in re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', page)]


def test_a_page_is_whole_and_its_verdict_comes_first(study, page):
    assert study.verdict is Verdict.NAMED
    text = plain(page)
    parts = (
        plain(typeset(verdict_sentence(study))),
        "Where the capsules disagree with it",
        "The p-value is the probability",
        "What would explain it",
        "log-likelihood ratio",
        "median G",
        "what would distinguish it",
        "The capsules were divided into halves at random",
        "residual p-value",
        "log score per capsule",
        "seed 3",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert "µs (68 %:" in text
    assert MotionBlur.separated_by in text
    tags = Tags(page)
    assert tags.open == []
    assert all(link.startswith("data:") for link in tags.links)
    assert len(tags.links) == len(pictures(page)) == 6
    assert all(picture.startswith("<svg") for picture in pictures(page))
    assert "<script" not in page


def test_what_is_printed_stands_on_the_page(study, page):
    parts = list(study_parts(study))
    tables = [part for part in parts if isinstance(part, pd.DataFrame)]
    assert len(tables) == 4
    (tried,) = (
        part for part in tables if part.attrs["title"] == "Explanations that were tried"
    )  # shorter than on the page
    for cell in (cell for row in tried.itertuples(index=False, name=None) for cell in row[:2]):
        assert plain(typeset(cell)) in plain(page)
    assert_same((part for part in parts if part is not tried), page, but=[f"Motion blur: {MotionBlur().changes}"])


def test_figures_show_the_regions_every_capsule_and_the_slopes(study):
    figure = outline_finding(study.comparison.along_outline, study.finding)
    words = " ".join(text.get_text() for text in figure.axes[0].texts)
    for name in ("nose", "flanks", "rear rim", "rear on the axis"):
        assert name in words
    assert "µm\n(" in words
    assert {"mean residual [µm]", "mean residual [standard errors]"} <= {ax.get_xlabel() for ax in figure.axes}
    share = arc_share(study.comparison.along_outline.outline)
    assert (share[0], share[-1] < 100.0) == (0.0, True)
    assert np.all(np.diff(share) > 0.0)
    left, right = trends(study.comparison, study.finding).axes
    for ax, name in ((left, r"v_\mathrm{o}"), (right, r"a/\ell")):
        assert name in ax.get_xlabel()
        assert "σ" in ax.get_title()
        assert len(ax.containers[0].lines[0].get_xdata()) == int(study.comparison.fits.settled.sum())
    sizes = study.verification.comparisons[1].fits.size[list(chosen_capsules(study.verification))]
    assert len(sizes) == 3
    assert np.all(np.diff(sizes) > 0.0)


def test_medians_stand_at_each_flow_rate(study, page):
    before, after = (one.modulus_at_flow_rates for one in study.verification.comparisons)
    assert len(before) >= 3
    for rate, (count, median) in before.items():
        moduli = [f"{1e3 * one:.1f} mN/m" for one in (median, after[rate][1])]
        cells = [f"{6e10 * rate:.3g} µL/min", str(count), *moduli]
        assert re.search(".{,60}".join(map(re.escape, cells)), page, re.DOTALL), cells


def test_other_verdicts_keep_what_they_have(study):
    unknown = replace(study, verdict=Verdict.UNKNOWN, in_question=(), verification=None)
    assert verdict_sentence(unknown).endswith("nothing that was tried explains it; motion blur comes nearest.")
    assert "Does it hold" not in study_page(unknown)
    ambiguous = replace(study, verdict=Verdict.AMBIGUOUS, verification=None, something_else=True)
    assert "What would distinguish them: the width of the edges at nose and flanks" in study_page(ambiguous)
    assert verdict_sentence(ambiguous).endswith("more than one explanation is possible: motion blur or something else.")


def test_where_g_s_is_not_known_that_is_said(study):
    odds = study.odds
    unknown = replace(study, odds=replace(odds, other=odds.exact[("exposure",)] + 10.0))
    assert any(words.startswith("G_s is not known while") for words in opening(unknown))
    assert not any("G_s is not known while" in words for words in opening(study))
    found, wide = study.surface_shear_modulus, unknown.surface_shear_modulus
    assert wide.high / wide.low > found.high / found.low


def test_a_name_says_how_often_it_is_wrong(study):
    rates = Calibration(2.0, 0.01, 0.54)
    (sentence,) = (words for words in opening(replace(study, calibration=rates)) if "a wrong one" in words)
    assert "a wrong one, in 1 % of sessions like this one; of those that are tried, 54 % get theirs" in sentence


def both_of(study, names):
    """The study with two effects of given names that act together, both scored as motion blur."""
    trial = study.trials["exposure"]
    pair = Pair(*(replace(trial.scores, effect=study.candidates[name]) for name in names), trial.fits, 1.0)
    exact = {names: study.odds.exact[("exposure",)], **study.odds.exact}
    odds = replace(
        study.odds, exact=exact, like={**study.odds.like, names: -9.0}, visibility={**study.odds.visibility, names: 9.0}
    )
    return replace(study, verdict=Verdict.NAMED, in_question=(names,), pairs={names: pair}, odds=odds)


def test_two_effects_are_shown_together(study):
    names = "exposure", "halo"
    both = both_of(replace(study, candidates={**BLUR, "halo": Halo()}), names)
    assert "motion blur and halo explain it together: t_e = " in verdict_sentence(both)
    page = study_page(both)
    assert "the other half tells of motion blur and halo" in plain(page)
    assert "are those with the other" in page
    either = replace(both, verdict=Verdict.AMBIGUOUS, in_question=(names, ("exposure",)), something_else=True)
    assert verdict_sentence(either).endswith("possible: motion blur with halo, motion blur or something else.")


def tried_as(effect, model, session, white, without):
    """A trial of an effect that changes nothing at any size."""
    sizes = effect.prior.ppf([0.2, 0.8])
    return Trial(model, effect, session, white, without, known={float(size): Outcome.of(without) for size in sizes})


def test_few_of_many_explanations_are_printed_within_eighty_columns(study, capsys):
    trial, log = study.trials["exposure"], study.odds.exact[("exposure",)]
    names = {(name,): log - 9.0 for name in SIMULATED}
    further = {"like": dict.fromkeys(names, -9.0), "visibility": dict.fromkeys(names, 1.0)}
    odds = replace(study.odds, exact={**study.odds.exact, **names})
    odds = replace(odds, **{name: {**getattr(odds, name), **more} for name, more in further.items()})
    made = trial.model, trial.session, trial.white, trial.without
    other = {name: tried_as(each, *made) for name, each in SIMULATED.items()}
    many = replace(study, odds=odds, candidates={**BLUR, **SIMULATED}, trials={**study.trials, **other})
    frame, rest = explanation_table(many, every=False)
    assert set(rest) < {each.name for each in SIMULATED.values()}
    assert len(frame) + len(rest) == len(SIMULATED) + 3  # with motion blur, something else and no effect
    print_parts(*study_parts(many))
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    assert all(name in " ".join(printed.partition("Less likely:")[2].split()) for name in rest)
    (bold,) = (cell for cell in frame["effect"] if isinstance(cell, Strong))
    assert bold == "motion blur"


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (
            ("pre_inflation", "strain_hardening"),
            "and a membrane that is pre-inflated and strain-hardening explains it: ",
        ),
        (("area_dilation_modulus", "bending"), "less resistant to a change of area and stiffer in bending explains"),
        (("pre_inflation", "corner_radius"), "pre-inflation and rounded corners explain it together: "),
    ],
)
def test_effects_of_the_membrane_say_what_it_is(study, names, words):
    assert words in verdict_sentence(both_of(replace(study, candidates={**BLUR, **SIMULATED}), names))


def test_effects_that_are_added_up_are_said(study):
    before, after = study.verification.comparisons
    assert not any("added up" in sentence for sentence in caveats(study))
    model = Surrogate.open("square-skalak") + SIMULATED["pre_inflation"] + SIMULATED["bending"]
    several = replace(after, model=FixedParameters(model, {"pre_inflation": 0.01, "bending": 1e-3}))
    assert several.added_up == after.fits.settled.sum() > 0
    said = replace(study, verification=replace(study.verification, comparisons=(before, several)))
    (sentence,) = (words for words in caveats(said) if "added up" in words)
    assert sentence.startswith(f"At {several.added_up} of {len(several.session)} capsules")


def test_lengths_alone_are_said_and_leave_no_outlines(model, study):
    session, _ = drawn_session(model, 14, seed=7)
    alone = diagnose(session, model, seed=3, candidates=BLUR, level=1.0)
    page = study_page(alone)
    assert "Lengths alone were given" in page
    assert len(pictures(page)) == 2 if alone.verification is None else 3
    first, *others = study.session.measurements
    mixed = Session([replace(first, outline=None), *others], study.session.experiment)
    said = opening(replace(study, session=mixed))
    assert any(words.startswith("No outline is known of 1 of 14 capsules") for words in said)
    assert not any("no outline" in words or "Lengths alone" in words for words in opening(study))


def test_no_disagreement_or_too_few_capsules_make_a_shorter_page(model):
    session, _ = drawn_session(model, 24, seed=7)
    left_out = replace(session, left_out=("a.toml: expected <this>, got that",))
    study = diagnose(left_out, model, seed=3, candidates={"exposure": MotionBlur()})
    page = study_page(study)
    assert study.verdict is Verdict.NONE
    assert "No disagreement was found" in page
    assert "How the capsules compare with it" in page
    assert "Where the capsules disagree with it" not in page
    assert "What would explain it" not in page
    assert "1 capsule was left out" in page
    assert "expected &lt;this&gt;" in page
    assert Tags(page).open == []
    session, _ = drawn_session(model, 6, seed=7)
    page = study_page(diagnose(session, model, seed=3))
    assert "These data cannot tell: 6 capsules are too few" in page
    assert not pictures(page)
