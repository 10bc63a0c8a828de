"""What any benchmark goes through: computed once, kept at once, shown between the marks of a page."""

import json

import pytest

from capsbayes.run import Store
from evidence.benchmarks.counts import covered
from evidence.benchmarks.stored import Stored, complete
from evidence.markdown import between_marks, table


def stops():
    raise KeyboardInterrupt


@pytest.fixture
def stored(tmp_path):
    (tmp_path / "page.md").write_text(f"before\n{between_marks('sums', 'of old')}\nafter\n")
    made = Stored("sums.json", "page.md", lambda sums: {"sums": table(("of", "sum"), sums.items())})
    made.file, made.page = tmp_path / "sums.json", tmp_path / "page.md"
    return made


def test_what_is_there_when_a_run_is_stopped_is_not_computed_again(stored):
    with pytest.raises(KeyboardInterrupt):
        stored.completed([("1, 2", lambda: "3"), ("2, 2", stops)])
    assert json.loads(stored.file.read_text()) == {"1, 2": "3"}
    assert stored.completed([("1, 2", stops), ("2, 2", lambda: "4")]) == {"1, 2": "3", "2, 2": "4"}


def test_answers_are_told_apart_by_the_words_of_their_session(stored):
    first = stored.answered([({"seed": 1, "row": "a"}, lambda: {"names": []})])
    again = stored.answered([({"seed": 1, "row": "a"}, stops), ({"seed": 2, "row": "a"}, lambda: {"names": ["b"]})])
    assert again == [*first, {"seed": 2, "row": "a", "names": ["b"]}] == stored.read()


def test_the_page_is_renewed_between_its_marks_and_only_if_asked(stored, capsys):
    old = stored.page.read_text()
    stored.show({"1, 2": "3"}, write=False)
    assert (stored.page.read_text(), stored.file.exists()) == (old, False)
    stored.show({"1, 2": "3"}, write=True)
    shown = "| of | sum |\n| --- | --- |\n| 1, 2 | 3 |"
    assert stored.page.read_text() == old.replace("of old", shown)
    assert capsys.readouterr().out == f"{shown}\n\n" * 2
    stored.page.write_text("without marks")
    with pytest.raises(ValueError, match="unpack"):
        stored.show({}, write=True)


def test_a_store_computes_what_it_lacks(tmp_path):
    store = Store.open(tmp_path / "parts", {"of": "sums"})
    complete(store, [("one", lambda: {"sum": 3})])
    complete(store, [("one", stops), ("two", lambda: {"sum": 4})])
    assert [store.load(name)["sum"] for name in ("one", "two")] == [3, 4]


def test_shares_have_their_binomial_interval():
    assert covered({"a 68": 7, "a 95": 9}, "a", 10) == "70 %, **90.0 %** (55 to 100)"
