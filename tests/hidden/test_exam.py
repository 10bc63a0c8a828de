"""The exam: how answers are told right from wrong, kept, and shown."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from capsbayes.discrepancy import Verdict
from capsbayes.hidden.answer import Answer, outcome_of
from capsbayes.hidden.cells import CELLS, Cell
from capsbayes.hidden.exam import examine
from capsbayes.hidden.exam_page import exam_page
from capsbayes.hidden.hideable import HIDEABLE
from capsbayes.hidden.pools import POOLS, pool_name

HALO = Cell("halo", "halo", 5e-7, known=True, clear=True)
PATTERN = Cell("pattern", "pattern", 0.02, known=False)
NOTHING = Cell("nothing", "none", 0.0, known=True)
ANSWER = Answer("right", ["halo"], 2e-4, 4.9e-7, 4.2e-7, 5.6e-7, 0.2, 0.01, 4.0, 1.0, 1.6, 1.01, 10.0)


@pytest.mark.parametrize(
    ("cell", "verdict", "names", "outcome"),
    [
        (HALO, Verdict.NONE, (), "none"),
        (HALO, Verdict.NOT_TESTABLE, (), "none"),
        (HALO, Verdict.NAMED, ("halo",), "right"),
        (HALO, Verdict.NAMED, ("bending",), "wrong"),
        (HALO, Verdict.AMBIGUOUS, ("bending", "halo"), "ambiguous"),
        (HALO, Verdict.AMBIGUOUS, ("bending", "exposure"), "wrong"),
        (HALO, Verdict.UNKNOWN, ("halo",), "unknown"),
        (PATTERN, Verdict.NAMED, ("bending",), "wrong"),
        (PATTERN, Verdict.AMBIGUOUS, ("bending", "exposure"), "ambiguous"),
        (PATTERN, Verdict.UNKNOWN, (), "unknown"),
        (NOTHING, Verdict.NAMED, ("bending",), "wrong"),
        (NOTHING, Verdict.NONE, (), "none"),
    ],
)
def test_answers_are_told_right_from_wrong(cell, verdict, names, outcome):
    assert outcome_of(cell, SimpleNamespace(verdict=verdict, names=names)) == outcome


def test_cells_hide_what_can_be_hidden_under_names_of_their_own():
    assert len({cell.name for cell in CELLS}) == len(CELLS)
    for cell in CELLS:
        assert cell.effect in HIDEABLE
        assert cell.shapes in POOLS


def test_the_page_counts_what_was_required():
    wrong = replace(ANSWER, outcome="wrong", names=["bending"], size=np.nan, low=np.nan, high=np.nan)
    none = replace(wrong, outcome="none", names=[], bias_after=np.nan)
    answers = {
        "halo": dict.fromkeys(range(1, 20), ANSWER) | {20: wrong},
        "pattern": dict.fromkeys(range(1, 11), replace(none, outcome="unknown")),
        "nothing": dict.fromkeys(range(1, 40), none) | {40: replace(none, outcome="unknown")},
    }
    page = exam_page([NOTHING, HALO, PATTERN], answers)
    for row in (
        "| claims where there is nothing: at most 5 % | 1 of 40, 2.5% [0.1%, 13.2%] | met |",
        "| wrong names in every cell: at most 2 % | 1 of 20, 5.0% [0.1%, 24.9%] (halo) | **missed** |",
        "| halo: right, or among several, at least 90 % | 19 of 20, 95.0% [75.1%, 99.9%] | met |",
        "| pattern: unknown or ambiguous, at least 90 % | 10 of 10, 100.0% [69.2%, 100.0%] | met |",
        "| halo: bias of G_s at least 5 times smaller with the effect | +20.0% to +1.0% | met |",
        "| 95 % intervals of the size cover 90 to 98 % | 19 of 19, 100.0% [82.4%, 100.0%] | **missed** |",
        "| halo | 20 | 0 | 19 | 0 | 0 | 1 | +20.0% | +1.0% | 1.60 | 1.01 | 19 of 19 |",
    ):
        assert row in page


@pytest.mark.slow
def test_answers_are_kept_and_not_sought_again(tmp_path, square_database):
    square_database.write(tmp_path / f"{pool_name('none', 0.0)}.nc")
    told = []
    few = replace(NOTHING, sessions=2)
    first = examine([few], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    more = examine([replace(few, sessions=3)], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    assert told == ["nothing: sessions 1 to 2 of 2", "nothing: sessions 3 to 3 of 3"]
    assert {seed: more["nothing"][seed].chance for seed in (1, 2)} == {
        seed: answer.chance for seed, answer in first["nothing"].items()
    }
    assert sorted(more["nothing"]) == [1, 2, 3]
