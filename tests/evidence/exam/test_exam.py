"""The exam: how sessions are drawn, answers judged and kept, the locked half guarded, and the page written."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from capsbayes.cli.effects_file import own_effects
from capsbayes.database import Database
from capsbayes.diagnosis import NOTHING, UNKNOWN, Verdict
from capsbayes.diagnosis.blind import TRUE_EFFECTS, Noise, _pairs, draw_session, edge_errors
from capsbayes.effects import catalogue
from capsbayes.errors import InputError
from capsbayes.run import run_tasks
from capsbayes.surrogate import Surrogate
from evidence.exam.answers import (
    _APART,
    Answer,
    _rounds,
    answer_session,
    check_frozen,
    code_digest,
    examine,
    freeze,
    frozen,
    log_score,
    outcome_of,
    stored,
)
from evidence.exam.foreign import FOREIGN, PATTERN, SmoothNoise
from evidence.exam.page import Share, exam_page
from evidence.exam.sessions import CELLS, HALVES, POOLS, Cell, cells_with, pool_name, read_pool

HALF = "development"  # whose shapes are all in the repository
OWN_EFFECT = Path(__file__).parents[3] / "examples" / "own_effect" / "own_effect.py"
HALO = Cell("halo", "halo", 0.02, known=True, sessions=10, clear=True)
UNKNOWN_FAULT = Cell("pattern", "pattern", 0.02, known=False, sessions=10)
NOTHING_HIDDEN = Cell("nothing", "none", 0.0, known=True, sessions=10)
BOTH = Cell("halo with bending", "halo", 0.02, known=True, also=(("bending", 2e-3),))
ANSWER = Answer(
    outcome="right", names=["halo"], p_value=2e-4, shapes=[1, 2, 3], log_score=-0.1, modulus=0.02, modulus_low=-0.05,
    modulus_high=0.1, apparent=0.2, true_size=5e-7, size=4.9e-7, low=4.2e-7, high=5.6e-7, seconds=30.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def square_database():
    return Database.open("square-neo-hookean")


def outcome(cell, verdict, *explanations, something_else=False):
    return outcome_of(cell, SimpleNamespace(verdict=verdict, in_question=explanations, something_else=something_else))


def test_outcomes_are_right_or_wrong_by_the_truth():
    one = {name: (name,) for name in ("halo", "bending", "exposure", "taper", "swelling")}
    both, other = ("bending", "halo"), ("halo", "rest_aspect")
    for cell, verdict, explanations, expected in (
        (HALO, Verdict.NONE, (), "none"),
        (HALO, Verdict.NOT_TESTABLE, (), "none"),
        (HALO, Verdict.NAMED, (one["halo"],), "right"),
        (HALO, Verdict.NAMED, (one["bending"],), "wrong"),
        (HALO, Verdict.NAMED, (both,), "wrong"),
        (HALO, Verdict.AMBIGUOUS, (one["bending"], one["halo"]), "small set"),
        (HALO, Verdict.AMBIGUOUS, tuple(one.values()), "large set"),
        (HALO, Verdict.AMBIGUOUS, (one["bending"], one["exposure"]), "wrong"),
        (HALO, Verdict.UNKNOWN, (), "unknown"),
        (BOTH, Verdict.NAMED, (both,), "right"),
        (BOTH, Verdict.AMBIGUOUS, (other, both), "small set"),
        (BOTH, Verdict.NAMED, (other,), "wrong"),
        (UNKNOWN_FAULT, Verdict.NAMED, (one["bending"],), "wrong"),
        (UNKNOWN_FAULT, Verdict.AMBIGUOUS, (one["bending"], one["exposure"]), "wrong"),
        (UNKNOWN_FAULT, Verdict.UNKNOWN, (), "unknown"),
        (NOTHING_HIDDEN, Verdict.AMBIGUOUS, (one["bending"],), "wrong"),
        (NOTHING_HIDDEN, Verdict.NONE, (), "none"),
    ):
        assert outcome(cell, verdict, *explanations) == expected, (cell.name, verdict, explanations)
    few = one["bending"], one["halo"], one["exposure"]
    for cell, explanations, expected in (
        (HALO, few, "large set"),
        (HALO, few[:1], "elsewhere"),
        (BOTH, few[:1], "part"),
        (UNKNOWN_FAULT, few[:1], "small set"),
        (NOTHING_HIDDEN, few[:1], "wrong"),
    ):
        assert outcome(cell, Verdict.AMBIGUOUS, *explanations, something_else=True) == expected


def test_the_log_score_is_that_of_what_was_hidden():
    study = SimpleNamespace(probabilities={"halo": 0.5, NOTHING: 0.25, UNKNOWN: 0.125})
    assert log_score(HALO, study) == pytest.approx(np.log(0.5))
    assert log_score(NOTHING_HIDDEN, study) == pytest.approx(np.log(0.25))
    assert log_score(UNKNOWN_FAULT, study) == pytest.approx(np.log(0.125))
    assert np.isnan(log_score(BOTH, study))
    assert np.isnan(log_score(HALO, SimpleNamespace(probabilities={})))


def test_cells_have_true_effects_and_names_of_their_own():
    assert len({cell.name for cell in CELLS}) == len(CELLS)
    for cell in CELLS:
        assert {*TRUE_EFFECTS, *FOREIGN, PATTERN.name} >= cell.names
        assert cell.true_effect(cell.drawn(1)[0]).name == cell.effect
        assert cell.shapes in POOLS


def test_the_catalogue_lacks_what_is_outside_of_it():
    for cell in CELLS:
        known = cell.candidates().keys()
        assert cell.null or (cell.names <= known if cell.known else not cell.names & known)


def test_each_session_has_a_laboratory_of_its_own():
    labs = [HALO.drawn(seed)[:2] for seed in range(1, 30)]
    assert HALO.drawn(1)[:2] == labs[0]
    assert HALO.drawn(1) != replace(HALO, name="another").drawn(1)
    assert len({lab.half_width for lab, _ in labs}) == len(labs)
    assert {type(lab.noise) for lab, _ in labs} == {Noise, SmoothNoise}
    assert {lab.flow_rate_error is None for lab, _ in labs} == {True, False}
    assert replace(HALO, flow_rates=True).drawn(1)[0].flow_rate_error is not None
    assert all(0.5 <= lab.noise.understated <= 2.0 for lab, _ in labs)
    assert HALO.size_in(labs[0][0]) == pytest.approx(0.02 * labs[0][0].half_width)


def test_the_pools_have_capsules_enough_for_every_session():
    folder = Path(__file__).parents[3] / "data" / "pools"
    pools = {pool: read_pool(folder, *pool, HALF).converged for pool in {cell.shapes for cell in CELLS}}
    for cell in CELLS:
        for seed in (_APART * HALVES[HALF] + number for number in range(1, cell.sessions + 1)):
            lab, count, other = cell.drawn(seed)
            truth = cell.true_effect(lab).lab(lab, cell.size_in(lab))
            assert len(_pairs(pools[cell.shapes], truth, count, np.random.default_rng(other))[0]) == count


def test_errors_along_the_edge_have_the_kernel_that_was_asked_for():
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    noise = SmoothNoise(scale=0.01, correlation_length=0.2, longer=2.0, understated=1.5)
    rng = np.random.default_rng(3)
    drawn = np.array([edge_errors(circle, noise, rng) for _ in range(4000)])
    apart = 4 * 2.0 * np.sin(np.pi / 60)
    expected = np.exp(-0.5 * (apart / 0.4) ** 2)
    assert np.std(drawn) == pytest.approx(0.015, rel=0.05)
    assert np.corrcoef(drawn[:, 0], drawn[:, 4])[0, 1] == pytest.approx(expected, abs=0.06)
    for kind in (Noise, SmoothNoise):
        assert np.isfinite(edge_errors(0.9 * circle, kind(correlation_length=0.3, longer=2.0), rng)).all()


def test_bounds_are_those_of_independent_sessions_or_wider():
    apart = Share.among(["p"] * 60, [[number] for number in range(60)], [False] * 60)
    assert (apart.counted, apart.of, apart.low) == (0, 60, 0.0)
    assert apart.high == pytest.approx(1.0 - 0.05 ** (1.0 / 60.0))  # Clopper and Pearson, none of 60
    alike = [[number // 20] for number in range(60)]  # three shapes, that decide what is said
    shared = Share.among(["p"] * 60, alike, [rows == [0] for rows in alike])
    assert shared.high > 0.6
    assert shared.low < 0.05
    assert str(Share.among([], [], [])) == "-"


def test_the_page_counts_what_was_required():
    wrong = replace(ANSWER, outcome="wrong", names=["bending"], size=np.nan, low=np.nan, high=np.nan, modulus_low=0.01)
    none = replace(wrong, outcome="none", names=[], modulus_low=-0.05)
    answers = {
        "halo": dict.fromkeys(range(1, 9), ANSWER) | {9: replace(ANSWER, outcome="small set"), 10: wrong},
        "pattern": dict.fromkeys(range(1, 9), replace(none, outcome="unknown")),
        "nothing": dict.fromkeys(range(1, 11), none),
    }
    page = exam_page([NOTHING_HIDDEN, HALO, UNKNOWN_FAULT], {"development": answers, "locked": {}})
    assert "**Not complete: 28 of 30 sessions, of 3 of 3 cells, so far.**" in page
    assert "No session of it has been diagnosed." in page
    for row in (
        "| claims where nothing is hidden: at most 5 % | 0 of 10, 0.0% [0.0%, 25.9%] | not yet |",
        "| wrong names or sets, all sessions: at most 2 % | 1 of 28, 3.6% [",
        "| clear sizes named, or in a set of at most 3: at least 90 % | 9 of 10, 90.0% [",
        "| wrong names or sets, outside the catalogue: at most 4 % | 0 of 8, 0.0% [",
        "| 95 % intervals of G_s hold the truth, in the catalogue: 90% to 98% | 9 of 10, 90.0% [",
        "| the same, in the kind outside where fewest do: at least 80% | 8 of 8, 100.0% [",
        "| flow rates stated |",
        "| 95 % intervals of the size hold it: 93% to 97% | 9 of 9, 100.0% [",
        "| halo, clear | 10 | 0 | 8 | 1 | 0 | 0 | 0 | 0 | 1 | -0.10 | 2.0% | 20.0% | 9 of 10 | 9 of 9 |",
    ):
        assert row in page
    complete = exam_page([NOTHING_HIDDEN], {"development": {"nothing": answers["nothing"]}, "locked": {}})
    assert "| 0 of 10, 0.0% [0.0%, 25.9%] | **missed** |" in complete


def test_the_locked_half_is_opened_with_the_recorded_diagnosis_only(tmp_path):
    with pytest.raises(InputError, match="--half locked: expected the record of this diagnosis, got none; freeze it"):
        check_frozen(tmp_path)
    freeze(tmp_path)
    check_frozen(tmp_path)
    assert frozen(tmp_path) == code_digest()
    (tmp_path / "frozen.json").write_text(json.dumps({"code": "other"}))
    with pytest.raises(InputError, match="that of another diagnosis"):
        check_frozen(tmp_path)
    freeze(tmp_path)  # nothing of the locked half was seen
    (tmp_path / "frozen.json").write_text(json.dumps({"code": "other"}))
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked" / "halo.jsonl").write_text("")
    with pytest.raises(InputError, match="not opened yet"):
        freeze(tmp_path)


def test_a_session_is_drawn_from_the_shapes_that_its_answer_names(square_database):
    lab = HALO.drawn(1)[0]
    blind = draw_session(square_database, TRUE_EFFECTS["none"], 0.0, lab=lab, capsules=12, seed=1)
    shapes = square_database.converged
    for capsule in blind.capsules:
        assert shapes["capillary_number"][capsule.row] == capsule.capillary_number
        assert shapes["size_ratio"][capsule.row] == capsule.size_ratio


def test_cells_without_answers_need_no_shapes(tmp_path):
    assert stored(CELLS, tmp_path / "pools", tmp_path / "out") == {}


@pytest.mark.slow
def test_answers_are_kept_and_not_sought_again(tmp_path, square_database):
    square_database.write(tmp_path / f"{pool_name('none', 0.0)}.nc")
    told = []
    few = Cell("nothing", "none", 0.0, True, sessions=1, outline=False)
    first = examine([few], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    (file,) = (tmp_path / "out" / "development").iterdir()  # no lock, no steps
    file.write_text(file.read_text() + '{"seed": 3, "outcome": "no')  # a run that was cut off
    more = examine([replace(few, sessions=2)], tmp_path, tmp_path / "out", workers=1, tell=told.append)
    assert [line.split(":")[1] for line in told] == [" 1 to diagnose", " 1 to diagnose"]
    seeds = [_APART * HALVES[HALF] + number for number in (1, 2)]
    assert more["nothing"][seeds[0]].p_value == first["nothing"][seeds[0]].p_value
    assert sorted(more["nothing"]) == seeds
    assert sorted(stored([few], tmp_path, tmp_path / "out")["nothing"]) == seeds
    assert stored([few], tmp_path, tmp_path / "out", half="locked") == {}


@pytest.mark.slow
def test_the_answer_to_a_session_says_what_was_hidden(square_database):
    answer = answer_session(HALO, 1, square_database, Surrogate.from_database(square_database))
    assert answer.outcome in ("right", "small set", "large set")
    assert "halo" in answer.names
    assert answer.modulus_low < answer.modulus < answer.modulus_high
    assert abs(answer.modulus) < abs(answer.apparent)


def test_a_session_of_every_cell_comes_first():
    assert list(_rounds(0)) == []
    assert list(_rounds(3)) == [(1, 1), (2, 2), (3, 3)]
    assert list(_rounds(10)) == [(1, 1), (2, 2), (3, 4), (5, 8), (9, 10)]


@pytest.mark.slow
def test_the_exam_hides_effects_of_a_file_and_tries_them_in_worker_processes():
    own = own_effects(OWN_EFFECT, catalogue(), Surrogate.open("square-neo-hookean"))
    cells = cells_with(own.effects, own.sha256)
    mine = [cell for cell in cells if cell.effect == "flank_shift"]
    assert len(mine) == 2
    assert 0.0 < mine[0].size < mine[1].size
    assert mine[1].true_effect(mine[1].drawn(1)[0]).unit == "m"
    (tried,) = run_tasks([lambda: [*mine[0].candidates()]], None, 1)
    assert {*tried} == {*catalogue(), "flank_shift"}
    assert all("flank_shift" in cell.candidates() for cell in cells)
