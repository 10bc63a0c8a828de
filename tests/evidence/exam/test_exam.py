"""The exam: how answers are judged, kept, and shown."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from capsbayes.diagnosis import Verdict
from capsbayes.evidence.blind.effects import TRUE_EFFECTS
from capsbayes.evidence.blind.pools import POOLS, pool_name
from capsbayes.evidence.exam.answer import Answer, answer_session, outcome_of
from capsbayes.evidence.exam.cells import CELLS, Cell, Decoy
from capsbayes.evidence.exam.examine import _read, _records, _rounds, examine
from capsbayes.evidence.exam.page import exam_page
from capsbayes.surrogate import Surrogate
from capsbayes.testing import check_effect

HALO = Cell("halo", "halo", 5e-7, known=True, clear=True)
PATTERN = Cell("pattern", "pattern", 0.02, known=False)
NOTHING = Cell("nothing", "none", 0.0, known=True)
BOTH = Cell("halo with bending", "halo", 5e-7, known=True, also=(("bending", 2e-3),))
DECOY = Cell("halo, a random pattern tried", "halo", 5e-7, known=False, decoy=True)
ANSWER = Answer(
    outcome="right",
    names=["halo"],
    p_value=2e-4,
    size=4.9e-7,
    low=4.2e-7,
    high=5.6e-7,
    bias_before=0.2,
    bias_after=0.01,
    log_likelihood_ratio=4.0,
    log_likelihood_ratio_error=1.0,
    misfit_before=1.6,
    misfit_after=1.01,
    gap_before=5e-7,
    gap_after=2.5e-7,
    distinguished="",
    measurements=0,
    seconds=10.0,
)


@pytest.mark.parametrize(
    ("cell", "verdict", "steps", "outcome"),
    [
        (HALO, Verdict.NONE, (), "none"),
        (HALO, Verdict.NOT_TESTABLE, (), "none"),
        (HALO, Verdict.NAMED, (("halo",),), "right"),
        (HALO, Verdict.NAMED, (("bending",),), "wrong"),
        (HALO, Verdict.NAMED, (("halo",), ("bending",)), "wrong"),
        (HALO, Verdict.AMBIGUOUS, (("bending", "halo"),), "ambiguous"),
        (HALO, Verdict.AMBIGUOUS, (("bending", "exposure"),), "wrong"),
        (HALO, Verdict.AMBIGUOUS, (("bending", "halo"), ("exposure",)), "wrong"),
        (HALO, Verdict.UNKNOWN, (("halo",),), "unknown"),
        (BOTH, Verdict.NAMED, (("halo",), ("bending",)), "right"),
        (BOTH, Verdict.NAMED, (("bending",),), "right"),
        (BOTH, Verdict.AMBIGUOUS, (("halo", "swelling"), ("bending",)), "ambiguous"),
        (BOTH, Verdict.NAMED, (("halo",), ("rest_aspect",)), "wrong"),
        (PATTERN, Verdict.NAMED, (("bending",),), "wrong"),
        (PATTERN, Verdict.AMBIGUOUS, (("bending", "exposure"),), "ambiguous"),
        (PATTERN, Verdict.UNKNOWN, (), "unknown"),
        (NOTHING, Verdict.NAMED, (("bending",),), "wrong"),
        (NOTHING, Verdict.NONE, (), "none"),
    ],
)
def test_outcomes_are_right_or_wrong_by_the_truth(cell, verdict, steps, outcome):
    study = SimpleNamespace(verdict=verdict, steps=[SimpleNamespace(in_question=names) for names in steps])
    assert outcome_of(cell, study) == outcome


def test_cells_have_true_effects_and_names_of_their_own():
    assert len({cell.name for cell in CELLS}) == len(CELLS)
    for cell in CELLS:
        assert TRUE_EFFECTS.keys() >= cell.sizes.keys()
        assert cell.shapes in POOLS


def test_the_page_counts_what_was_required():
    wrong = replace(ANSWER, outcome="wrong", names=["bending"], size=np.nan, low=np.nan, high=np.nan)
    none = replace(wrong, outcome="none", names=[], bias_after=np.nan)
    answers = {
        "halo": dict.fromkeys(range(1, 18), ANSWER)
        | dict.fromkeys((18, 19), replace(ANSWER, outcome="ambiguous", distinguished="right", measurements=2))
        | {20: wrong},
        "halo, a random pattern tried": dict.fromkeys(range(1, 11), replace(none, outcome="unknown", gap_after=4.9e-7)),
        "pattern": dict.fromkeys(range(1, 11), replace(none, outcome="unknown")),
        "nothing": dict.fromkeys(range(1, 40), none) | {40: replace(none, outcome="unknown")},
    }
    page = exam_page([NOTHING, HALO, PATTERN, DECOY], answers)
    assert "**Not complete: 80 of 96 sessions, of 4 of 4 cells, so far.**" in page
    for row in (
        "| claims where there is nothing: at most 5 % | 1 of 40, 2.5% [0.1%, 13.2%] | met |",
        "| wrong names in every cell: at most 2 % | 1 of 20, 5.0% [0.1%, 24.9%] (halo) | **missed** |",
        "| halo: right, after measurements if needed, at least 90 % | 19 of 20, 95.0% [75.1%, 99.9%] | met |",
        "| pattern: unknown or ambiguous, at least 90 % | 10 of 10, 100.0% [69.2%, 100.0%] | met |",
        "| halo: bias of G_s at least 5 times smaller with the effect | +20.0% to +1.0% | met |",
        "| 95 % intervals of the size cover 90 to 98 % | 19 of 19, 100.0% [82.4%, 100.0%] | **missed** |",
        "| halo, a random pattern tried: held-out gap shrinks by at most 5 % | 0.500 to 0.490 um | met |",
        "| halo | 20 | 0 | 17 | 2 | 0 | 1 | 2 of 2 by 2.0 | +20.0%, +1.0% | 1.60, 1.01 | 0.50, 0.25 | 19 of 19 |",
    ):
        assert row in page


@pytest.mark.slow
def test_answers_are_kept_and_not_sought_again(tmp_path, square_database):
    square_database.write(tmp_path / f"{pool_name('none', 0.0)}.nc")
    told = []
    few = replace(NOTHING, sessions=2)
    first = examine([few], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    (file,) = (tmp_path / "out").iterdir()  # no lock, no steps
    file.write_text(file.read_text() + '{"seed": 3, "outcome": "no')  # a run that was cut off
    more = examine([replace(few, sessions=3)], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    said = "of each of 1 cells:"
    assert told == [f"sessions 1 to 2 {said} 2 to diagnose", f"sessions 1 to 3 {said} 1 to diagnose"]
    assert {seed: more["nothing"][seed].p_value for seed in (1, 2)} == {
        seed: answer.p_value for seed, answer in first["nothing"].items()
    }
    assert sorted(more["nothing"]) == [1, 2, 3]
    half = replace(few, capsules=20)  # another work under the same name
    again = examine([half], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    assert told[2:] == [f"sessions 1 to 2 {said} 2 to diagnose"]
    assert sorted(again["nothing"]) == [1, 2]


@pytest.mark.slow
def test_look_alikes_are_distinguished_by_what_is_measured_elsewhere(square_database):
    cell = Cell("halo", "halo", 3e-7, known=True)
    model = Surrogate.from_database(square_database)
    answer = answer_session(cell, 1, square_database, model)
    assert answer.outcome == "ambiguous"
    assert {"halo", "pixel_scale"} <= set(answer.names)
    assert answer.distinguished == "right"
    assert 1 <= answer.measurements <= len(answer.names)
    assert answer.gap_after < answer.gap_before


def test_a_decoy_moves_edges_by_its_size_and_nothing_at_its_null_value():
    decoy = Decoy(3)
    check_effect(decoy, Surrogate.open("square-neo-hookean"))
    point = {"capillary_number": np.array([0.05]), "size_ratio": np.array([0.9])}
    model = Surrogate.open("square-neo-hookean")
    moved = (model + decoy)({**point, "decoy": np.array([0.02])}, outline=True).outline
    away = np.hypot(*(moved - model(point, outline=True).outline)[0].T)
    assert np.sqrt(np.mean(away**2)) == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize(
    ("last", "rounds"),
    [(0, []), (3, [(1, 3)]), (24, [(1, 4), (5, 8), (9, 16), (17, 24)]), (9, [(1, 4), (5, 8), (9, 9)])],
)
def test_a_few_sessions_of_every_cell_come_first(last, rounds):
    assert list(_rounds(last)) == rounds


def test_answers_of_earlier_versions_are_read(tmp_path):
    cell = CELLS[0]
    former = {
        "p_value": "chance",
        "log_likelihood_ratio": "gain",
        "log_likelihood_ratio_error": "gain_error",
        "distinguished": "told_apart",
    }
    old = {former.get(key, key): value for key, value in asdict(ANSWER).items()}
    records = _records(tmp_path, cell)
    records.add({"seed": 1, **old})
    records.add({"seed": 2, **asdict(ANSWER), "work": "other"})
    assert _read(tmp_path, cell, "work") == {1: ANSWER}
