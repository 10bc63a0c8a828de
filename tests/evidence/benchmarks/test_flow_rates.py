"""The table of wrong velocities, flow rates and widths is that of the stored answers, without a wrong name in it."""

import json

import pytest

from evidence.benchmarks import flow_rates


@pytest.fixture(scope="module")
def answers():
    return json.loads(flow_rates.STORED.read_text())


def test_the_page_shows_the_stored_table(answers):
    shown = flow_rates.PAGE.read_text().partition(flow_rates.BEGIN)[2].partition(flow_rates.END)[0]
    assert shown == flow_rates.table(answers)
    assert {each["row"] for each in answers} == {row.hidden for row in flow_rates.ROWS}


def test_nothing_is_claimed_where_nothing_is_hidden_and_no_name_is_wrong(answers):
    said = {each["said"] for each in answers if each["row"] == "nothing"}
    assert said == {"nothing found"}
    assert not [each for each in answers if each["said"] == "wrong"]


def test_an_outline_leaves_few_effects_in_question(answers):
    sets = [each["names"] for each in answers if each["kind"] == "outlines" and each["said"] == "in a set"]
    assert sets
    assert max(map(len, sets)) <= 4
