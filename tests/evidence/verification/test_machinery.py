"""What any topic goes through: computed once, kept, written on the page, judged."""

import json
import math

import pytest

from capsbayes.errors import CapsbayesError, InputError
from evidence.verification import verify
from evidence.verification.quantities import fitted_limit, fitted_rate
from evidence.verification.topic import Reference, Row, Target, Topic


def stops():
    raise KeyboardInterrupt


def fails():
    raise CapsbayesError("there is none")


class Counted:
    """A topic of two items, the second of which may fail, that counts what it computes."""

    def __init__(self, second=lambda: {"length": 2.5}):
        self.computed, self.second = [], second

    @property
    def topic(self):
        items = {"one": lambda: self.compute("one", lambda: {"length": 1.0, "series": [1.0, 2.0]})}
        items["two"] = lambda: self.compute("two", self.second)
        return Topic("topic", "A topic", "About it.", items, self.rows, lambda results, figure: figure.subplots())

    def compute(self, item, function):
        self.computed.append(item)
        return function()

    @staticmethod
    def rows(results):
        yield Row("first", results.value("one", "length"), Reference(1.001, "theory"), Target("relative", 0.01))
        yield Row("second", results.value("two", "length"), Reference(2.0, "a table"), Target("absolute", 0.1))
        yield Row("last of a series", results.value("one", "series"))


def page(folder):
    return (folder / "verification.md").read_text()


def line(folder, quantity):
    (found,) = (one for one in page(folder).splitlines() if one.startswith(f"| {quantity} |"))
    return [cell.strip() for cell in found.split("|")[1:-1]]


def test_the_page_has_the_rows_of_the_results_and_says_what_is_missed(tmp_path):
    tables = verify([Counted().topic], tmp_path)
    assert [row.verdict for row in tables["topic"]] == ["met", "missed", ""]
    assert line(tmp_path, "first") == ["first", "1.001", "theory", "1", "-0.1 %", "within 1 %", "met"]
    assert line(tmp_path, "second") == ["second", "2", "a table", "2.5", "+5.0e-01", "within 0.1", "**missed**"]
    assert line(tmp_path, "last of a series") == ["last of a series", "", "", "2", "", "", ""]
    assert line(tmp_path, "[A topic](#a-topic)")[1:4] == ["1", "1", "0"]
    assert "![A topic](topic.png)" in page(tmp_path)
    assert (tmp_path / "topic.png").read_bytes().startswith(b"\x89PNG")


def test_only_what_is_missing_is_computed(tmp_path):
    stopped = Counted(stops)
    with pytest.raises(KeyboardInterrupt):
        verify([stopped.topic], tmp_path)
    again, told = Counted(), []
    verify([again.topic], tmp_path, tell=told.append)
    assert (stopped.computed, again.computed, told) == (["one", "two"], ["two"], ["A topic: two"])
    kept = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [(record["topic"], record["item"]) for record in kept] == [("topic", "one"), ("topic", "two")]
    assert kept[0]["values"] == {"length": 1.0, "series": [1.0, 2.0]}
    verify([again.topic], tmp_path)
    assert again.computed == ["two"]
    assert not list(tmp_path.glob(".*"))


def test_a_failure_is_told_and_the_rest_goes_on(tmp_path):
    tables = verify([Counted(fails).topic], tmp_path)
    assert [row.verdict for row in tables["topic"]] == ["met", "not computed", ""]
    assert "Without a result: two, because there is none" in page(tmp_path)
    assert "topic.png" in page(tmp_path)


def test_one_topic_alone(tmp_path):
    one, other = Counted(), Counted()
    renamed = Topic("other", "Other", "", other.topic.items, other.rows)
    verify([one.topic, renamed], tmp_path, only="other")
    assert (one.computed, other.computed) == ([], ["one", "two"])
    assert "Not computed yet: one, two." in page(tmp_path)
    assert "topic.png" not in page(tmp_path)
    with pytest.raises(InputError, match=r"only: expected one of topic, other, got 'none'"):
        verify([one.topic, renamed], tmp_path, only="none")


def test_results_of_earlier_versions_are_read(tmp_path):
    verify([Counted().topic], tmp_path)
    file = tmp_path / "results.jsonl"
    file.write_text(file.read_text().replace('{"topic": "topic"', '{"section": "topic"'))
    again = Counted()
    assert verify([again.topic], tmp_path)["topic"][0].ours == 1.0
    assert again.computed == []


def test_damaged_results_are_refused(tmp_path):
    one = '{"topic": "topic", "item": "one", "seconds": 1, "values": '
    for line in ('{"topic": []}', "{}", "5", one + "[]}", one + '{"value": {}}}'):
        (tmp_path / "results.jsonl").write_text(f"{line}\n")
        with pytest.raises(InputError, match=r"results of the verification, got .*remove it"):
            verify([Counted().topic], tmp_path)


@pytest.mark.parametrize("line", ["{", "{" * 100_000, "\u2028"])
def test_a_line_that_was_cut_off_is_computed_again(tmp_path, line):
    (tmp_path / "results.jsonl").write_text(f"{line}\n")
    again = Counted()
    assert verify([again.topic], tmp_path)["topic"][0].ours == 1.0
    assert again.computed == ["one", "two"]


def test_limits():
    assert Row("quantity", 1.0, target=Target("at most", 1.0)).verdict == "met"
    assert Row("quantity", 1.1, target=Target("at most", 1.0)).verdict == "missed"
    assert Row("quantity", 0.9, target=Target("at least", 1.0)).verdict == "missed"
    assert Row("quantity", math.nan, target=Target("at least", 1.0)).verdict == "not computed"


def test_rates_of_what_is_missing_are_missing():
    assert math.isnan(fitted_rate([4, 8], [1.0, math.nan]))
    assert all(map(math.isnan, fitted_limit([4, 6, 8], [1.0, math.nan, 2.0])))
