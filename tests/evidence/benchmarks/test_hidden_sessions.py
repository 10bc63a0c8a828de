"""The tables of sessions that are hard to diagnose are those of the stored answers, and no name in them is wrong."""

import pytest

from evidence.benchmarks import hidden_sessions, picture_sessions

BENCHMARKS = (hidden_sessions, picture_sessions)


@pytest.mark.parametrize("benchmark", BENCHMARKS)
def test_the_page_shows_the_stored_table(benchmark):
    begin, end = benchmark.MARKS
    shown = hidden_sessions.PAGE.read_text().partition(begin)[2].partition(end)[0]
    assert shown == "\n".join(hidden_sessions.table(benchmark.ROWS, hidden_sessions.stored(benchmark.STORED))) + "\n"
    assert all(row.hidden in shown for row in benchmark.ROWS)


@pytest.mark.parametrize("benchmark", BENCHMARKS)
def test_no_name_is_wrong(benchmark):
    rows = {row.hidden: row for row in benchmark.ROWS}
    outcomes = {
        (answer["hidden"], hidden_sessions.outcome(rows[answer["hidden"]], answer))
        for answer in hidden_sessions.stored(benchmark.STORED)
    }
    assert outcomes
    wrong = {hidden for hidden, outcome in outcomes if outcome in ("**wrong name**", "ambiguous without it")}
    assert not wrong


def test_sizes_that_are_found_in_pictures_are_true():
    sizes = {"pre_inflation": 0.035, "strain_hardening": 0.8, "rest_aspect": 0.925, "section_aspect": 1.075}
    sizes |= {"pixel_aspect": 1.04, "hooke_share": 1.0}
    rows = {row.hidden: row for row in picture_sessions.ROWS}
    held = [
        low <= sizes[name] <= high
        for answer in hidden_sessions.stored(picture_sessions.STORED)
        for name, (low, high) in answer["intervals_95"].items()
        if rows[answer["hidden"]].truth == (name,)
    ]
    assert len(held) == sum(len(answer["names"]) == 1 for answer in hidden_sessions.stored(picture_sessions.STORED))
    assert sum(held) >= len(held) - 1
