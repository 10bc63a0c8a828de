"""The table of sessions that look alike is that of the stored answers, and no name in it is wrong."""

import hidden_sessions


def test_the_page_shows_the_stored_table():
    shown = hidden_sessions.PAGE.read_text().partition(hidden_sessions.BEGIN)[2].partition(hidden_sessions.END)[0]
    assert shown == "\n".join(hidden_sessions.table(hidden_sessions.stored())) + "\n"
    assert all(row.hidden in shown for row in hidden_sessions.ROWS)


def test_no_name_is_wrong():
    rows = {row.hidden: row for row in hidden_sessions.ROWS}
    outcomes = [hidden_sessions.outcome(rows[answer["hidden"]], answer) for answer in hidden_sessions.stored()]
    assert outcomes
    assert not {"**wrong name**", "ambiguous without it"} & {*outcomes}
