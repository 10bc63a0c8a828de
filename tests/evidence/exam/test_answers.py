"""The pages state what the answers that are kept say, and one diagnosis gave all of the locked half."""

from dataclasses import fields
from pathlib import Path

import pytest

from evidence.exam.answers import Answer, _records, frozen
from evidence.exam.page import exam_page
from evidence.exam.sessions import CELLS, HALVES

ROOT = Path(__file__).parents[3]
DOCS, EXAM = ROOT / "docs", ROOT / "data" / "exam"
PAGE = ROOT / "evidence" / "results" / "exam.md"
KEYS = [field.name for field in fields(Answer)]
STATED = (
    ("../README.md", "all", "of G_s in {held} of {sessions} [blind sessions]"),
    ("../README.md", "all", "a wrong name or set was given in {wrong}."),
    ("limits.md", "strain hardening 0.8", "of 0.8 was named in {right} of {sessions} sessions"),
    ("limits.md", "strain hardening 0.3", "and one of 0.3 in {right} of {sessions}"),
    (
        "limits.md",
        "hooke share 1",
        "| among the effects tried | {sessions} | {right} | {small}, at most three | {unknown} | {none} | {wrong} |",
    ),
    (
        "limits.md",
        "hooke share 1, not in the catalogue",
        "| not among them | {sessions} | | {several} | {unknown} | {none} | {wrong} |",
    ),
    ("limits.md", "hooke share 1, not in the catalogue", "held the truth in {held} of these {sessions} sessions"),
    (
        "limits.md",
        "modulus slope 0.7",
        "a modulus that grows as $a^{{0.7}}$ was missed in {none} of {sessions} sessions",
    ),
    ("limits.md", "modulus slope 2", "and one that grows as $a^2$ in {none} of {sessions}"),
    (
        "limits.md",
        "distortion -0.01",
        "a barrel of 1 % a half width from the middle was missed in {none} of {sessions} sessions",
    ),
    ("limits.md", "tried", "a wrong name or set was given in {wrong} of {sessions} sessions"),
    ("limits.md", "tried", "and the 95 % interval of G_s held the truth in {held}"),
    ("limits.md", "not tried", "another one was named in {wrong} of {sessions}."),
    ("limits.md", "not tried", "interval of G_s held the truth in {held} of {sessions} (90 % were required)"),
    ("limits.md", "nothing hidden", "where nothing was hidden in {claimed} of {sessions}"),
    ("limits.md", "clear", "was named, or in a set of at most three, in {told} of {sessions}"),
    ("limits.md", "strain hardening 0.3", "a hardening of 0.3 was missed in {none} of {sessions} sessions"),
    ("limits.md", "section aspect 1.03", "a cross-section deeper by 3 % in {none} of {sessions}"),
    ("limits.md", "corner radius 0.16", "corners rounded by 0.16 l in {none} of {sessions}"),
    (
        "limits.md",
        "pixel scale 0.025",
        "one effect was named in {right} of {sessions} sessions and several were in question in {several}",
    ),
    ("limits.md", "exposure 0.05, not in the catalogue", "that was not tried in {several} of {sessions} sessions"),
    (
        "limits.md",
        "rest aspect 1.075, not in the catalogue",
        "of a shape at rest that is no sphere in {several} of {sessions}.",
    ),
    (
        "limits.md",
        "rest aspect 1.075, not in the catalogue",
        "in {held} of {sessions} with a shape at rest that is no sphere",
    ),
    ("limits.md", "Hooke's law with nu_s = 1/3", "It held the truth in {held} of {sessions} with Hooke's law"),
    (
        "limits.md",
        "hooke share 1, not in the catalogue",
        "it held the truth in {held} of {sessions} sessions with a share of Hooke's law",
    ),
    ("limits.md", "two batches", "one of which is twice as stiff, in {none} of {sessions}"),
    ("limits.md", "viscosity that drifts", "a viscosity that drifts by 30 % in {none} of {sessions}."),
    ("diagnosing.md", "nothing hidden", "Something was found where nothing was hidden in {claimed} of {sessions}"),
    (
        "limits.md",
        "pre inflation 0.035, not in the catalogue",
        "held the truth in {held} of {sessions} sessions; {unknown} of them ended as unknown",
    ),
    ("diagnosing.md", "pixel aspect 1.04", "pixels oblong by 4 % were named in {right} of {sessions} sessions"),
    ("diagnosing.md", "pixel aspect 1.02", "and by 2 % in {right} of {sessions}, with others in question in {several}"),
    (
        "diagnosing.md",
        "distortion -0.01",
        "A barrel of 1 % a half width from the middle was missed in {none} of {sessions}",
    ),
    ("diagnosing.md", "distortion -0.02", "one of 2 % in {none} of {sessions}"),
    ("diagnosing.md", "taper 0.004", "a taper of 0.004 was missed in {none} of {sessions}"),
    ("diagnosing.md", "taper 0.01", "one of 0.01 in {none} of {sessions}"),
    ("evidence.md", "clear", "were named, or in a set of at most three, in {told} of {sessions} sessions"),
    ("evidence.md", "all", "a wrong one was named in {wrong} of {sessions}. Two of nine requirements were missed"),
    ("diagnosing.md", "pre inflation 0.015", "an inflation of 1.5 % was named in {right} of {sessions} sessions"),
    ("diagnosing.md", "all", "A wrong name or set was given in {wrong} of {sessions} sessions"),
    ("diagnosing.md", "not tried", "in {wrong} of the {sessions} whose effect was none"),
)


@pytest.fixture(scope="module")
def lines():
    """Return the lines of each half, by cell."""
    return {half: {cell.name: list(_records(EXAM / half, cell).read()) for cell in CELLS} for half in HALVES}


@pytest.fixture(scope="module")
def answers(lines):
    """Return the answers of each half, by cell and seed."""
    return {
        half: {
            name: {line["seed"]: Answer(**{key: line[key] for key in KEYS}) for line in of_cell}
            for name, of_cell in of_half.items()
        }
        for half, of_half in lines.items()
    }


def test_one_diagnosis_gave_the_answers_of_the_locked_half(lines):
    assert {line["code"] for of_cell in lines["locked"].values() for line in of_cell} == {frozen(EXAM)}


def test_the_page_of_the_exam_is_that_of_the_answers(answers):
    assert exam_page(CELLS, answers) == PAGE.read_text()


def test_limits_say_how_many_requirements_were_missed(answers):
    page = exam_page(CELLS, {"locked": answers["locked"]})
    assert page.count("| **missed** |") == 2
    assert page.count("| met |") == 7
    said = " ".join((DOCS / "limits.md").read_text().split())
    assert "Of nine requirements the locked half of the [exam](../evidence/results/exam.md) met seven." in said


def test_limits_say_in_which_kinds_outside_the_catalogue_the_interval_of_g_s_is_seldom_right(answers):
    held = {
        cell.name: sum(
            answer.modulus_low <= 0.0 <= answer.modulus_high for answer in answers["locked"][cell.name].values()
        )
        for cell in GROUPS["not tried"]
    }
    seldom = {name for name, count in held.items() if count < 11}
    assert seldom == {"hooke share 1, not in the catalogue"}
    assert "in 11 of 13 or more" in (DOCS / "limits.md").read_text()


def test_limits_say_where_a_name_was_wrong(answers):
    wrong = [(cell.name, answer.outcome) for cell in GROUPS["all"] for answer in answers["locked"][cell.name].values()]
    assert sorted(name for name, outcome in wrong if outcome == "wrong") == [
        "Hooke's law with nu_s = 1/3",
        "Hooke's law with nu_s = 1/3",
        "nothing",
        "nothing",
        "pixel scale 0.025",
        "pixel scale 0.025",
        "walls read wrongly",
    ]


GROUPS = {
    "all": [cell for cell in CELLS if cell.counted],
    "tried": [cell for cell in CELLS if cell.known],
    "not tried": [cell for cell in CELLS if cell.counted and not cell.known],
    "nothing hidden": [cell for cell in CELLS if cell.null],
    "clear": [cell for cell in CELLS if cell.known and cell.clear],
}


@pytest.mark.parametrize(("page", "hidden", "words"), STATED)
def test_other_pages_state_figures_of_the_locked_half(page, hidden, words, answers):
    names = [cell.name for cell in GROUPS.get(hidden, ())] or [hidden]
    mine = [answer for name in names for answer in answers["locked"][name].values()]
    outcomes = [answer.outcome for answer in mine]
    counted = {name: outcomes.count(name) for name in ("none", "right", "unknown", "wrong")}
    counted |= {"small": outcomes.count("small set"), "several": sum("set" in outcome for outcome in outcomes)}
    counted |= {"claimed": len(mine) - counted["none"], "told": counted["right"] + counted["small"]}
    counted["held"] = sum(answer.modulus_low <= 0.0 <= answer.modulus_high for answer in mine)
    assert words.format(sessions=len(mine), **counted) in " ".join((DOCS / page).read_text().split())
