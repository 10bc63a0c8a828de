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
from capsbayes.effects import SIMULATED, MotionBlur
from capsbayes.model import FixedParameters
from capsbayes.profile import arc_share
from capsbayes.report import study_page, verdict_sentence
from capsbayes.report.study import caveats, likeliest_table, odds_words, opening, study_parts
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
        "p-value",
        "What would explain it",
        "odds relative to no effect",
        "median G",
        "what would distinguish it",
        "held-out capsules",
        "7 held-out capsules",
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
    (tried,) = (part for part in tables if part.attrs["title"] == "Effects that were tried")  # shorter than on the page
    for cell in (cell for row in tried.itertuples(index=False, name=None) for cell in row[:2]):
        assert plain(typeset(cell)) in plain(page)
    assert_same((part for part in parts if part is not tried), page, but=[f"Motion blur: {MotionBlur().changes}"])


def test_figures_show_the_regions_every_capsule_and_the_slopes(study):
    figure = outline_finding(study.first_half.along_outline, study.finding)
    words = " ".join(text.get_text() for text in figure.axes[0].texts)
    for name in ("nose", "flanks", "rear rim", "rear on the axis"):
        assert name in words
    assert "µm (" in words
    assert {"mean residual [µm]", "mean residual [standard errors]"} <= {ax.get_xlabel() for ax in figure.axes}
    share = arc_share(study.first_half.along_outline.outline)
    assert (share[0], share[-1] < 100.0) == (0.0, True)
    assert np.all(np.diff(share) > 0.0)
    left, right = trends(study.first_half, study.finding).axes
    for ax, name in ((left, r"v_\mathrm{o}"), (right, r"a/\ell")):
        assert name in ax.get_xlabel()
        assert "σ" in ax.get_title()
        assert len(ax.containers[0].lines[0].get_xdata()) == int(study.first_half.fits.settled.sum())
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
    nothing = tuple(replace(step, in_question=()) for step in study.steps)
    unknown = study_page(replace(study, verdict=Verdict.UNKNOWN, steps=nothing, verification=None))
    assert "and nothing that was tried explains it." in unknown
    assert "Does it hold" not in unknown
    failed = replace(study, verdict=Verdict.UNKNOWN)
    assert verdict_sentence(failed).endswith("nothing that was tried explains it; motion blur comes nearest.")
    ambiguous = replace(study, verdict=Verdict.AMBIGUOUS, verification=None)
    assert "What would distinguish them: the width of the edges at nose and flanks" in study_page(ambiguous)
    assert verdict_sentence(ambiguous).endswith("more than one effect may explain it: motion blur.")


def test_two_effects_are_shown_one_after_the_other(study):
    (step,) = study.steps
    both = replace(study, verdict=Verdict.NAMED, steps=(step, step))
    assert "motion blur and motion blur explain it together: t_e = " in verdict_sentence(both)
    page = study_page(both)
    assert "The size of motion blur and motion blur was found on one half" in page
    assert "are those with the other" in page
    either = replace(step, in_question=("exposure", "exposure", "exposure"))
    ambiguous = replace(study, verdict=Verdict.AMBIGUOUS, steps=(either, step))
    assert verdict_sentence(ambiguous).endswith("it: motion blur, motion blur or motion blur, with motion blur.")


def test_few_of_many_effects_are_printed_within_eighty_columns(study, capsys):
    (step,) = study.steps
    tried = step.scores["exposure"]
    others = {name: replace(tried, effect=effect) for name, effect in SIMULATED.items()}
    steps = (replace(step, scores={**step.scores, **others}),)
    many = replace(study, steps=steps, evidence={**study.evidence, **dict.fromkeys(others, -1.0)})
    frame, rest = likeliest_table(many)
    names = {scores.effect.name for scores in many.scores.values()}
    assert set(rest) < names
    assert len(frame) + len(rest) == len(names) + 2  # something else and no effect
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
        (("strain_hardening",), "and strain hardening explains it: h = "),
    ],
)
def test_effects_of_the_membrane_say_what_it_is(study, names, words):
    (step,) = study.steps
    tried = step.scores["exposure"]
    scores = {name: replace(tried, effect=SIMULATED[name]) for name in names}
    steps = tuple(replace(step, in_question=(name,), scores={name: scores[name]}) for name in names)
    assert words in verdict_sentence(replace(study, verdict=Verdict.NAMED, steps=steps))


def test_effects_that_are_added_up_are_said(study):
    before, after = study.verification.comparisons
    assert not any("added up" in sentence for sentence in caveats(study))
    model = Surrogate.open("square-skalak") + SIMULATED["pre_inflation"] + SIMULATED["bending"]
    several = replace(after, model=FixedParameters(model, {"pre_inflation": 0.01, "bending": 1e-3}))
    assert several.added_up == after.fits.settled.sum() > 0
    said = replace(study, verification=replace(study.verification, comparisons=(before, several)))
    (sentence,) = (words for words in caveats(said) if "added up" in words)
    assert sentence.startswith(f"At {several.added_up} of {len(several.session)} held-out capsules")


def test_lengths_alone_are_said_and_leave_no_outlines(model, study):
    session, _ = drawn_session(model, 14, seed=7)
    alone = diagnose(session, model, seed=3, candidates=BLUR, level=1.0)
    page = study_page(alone)
    assert "Lengths alone were given" in page
    assert len(pictures(page)) == 2 if alone.verification is None else 3
    first, *others = study.session.measurements
    mixed = Session([replace(first, outline=None), *others], study.session.experiment)
    assert any(words.startswith("1 of 14 capsules have no outline") for words in opening(replace(study, session=mixed)))
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
    assert "1 capsules were left out" in page
    assert "expected &lt;this&gt;" in page
    assert Tags(page).open == []
    session, _ = drawn_session(model, 6, seed=7)
    page = study_page(diagnose(session, model, seed=3))
    assert "These data cannot tell: 6 capsules are too few" in page
    assert not pictures(page)


def test_odds():
    words = {0.0: "1 : 1", 1.0: "2.7 : 1", -3.0: "1 : 20", 900.0: "more than 1000 : 1", -900.0: "less than 1 : 1000"}
    assert {ratio: odds_words(ratio) for ratio in words} == words
