"""The tables of sessions that are hard to diagnose are those of the stored answers, and no name in them is wrong."""

import hidden_sessions
import picture_sessions
import pytest

BENCHMARKS = (hidden_sessions, picture_sessions)


@pytest.mark.parametrize("benchmark", BENCHMARKS)
def test_the_page_shows_the_stored_table(benchmark):
    begin, end = benchmark.MARKS
    shown = hidden_sessions.PAGE.read_text().partition(begin)[2].partition(end)[0]
    assert shown == "\n".join(hidden_sessions.table(benchmark.ROWS, benchmark.stored())) + "\n"
    assert all(row.hidden in shown for row in benchmark.ROWS)


@pytest.mark.parametrize("benchmark", BENCHMARKS)
def test_no_name_is_wrong(benchmark):
    rows = {row.hidden: row for row in benchmark.ROWS}
    outcomes = [hidden_sessions.outcome(rows[answer["hidden"]], answer) for answer in benchmark.stored()]
    assert outcomes
    assert not {"**wrong name**", "ambiguous without it"} & {*outcomes}
