"""A bar is shown on a terminal only, and counts to the end."""

import sys

import pytest

from capsbayes.run import progress_bar, tracked


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_counts_on_a_terminal_only(monkeypatch, capsys, terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    assert list(tracked("abc", 3, "letters")) == ["a", "b", "c"]
    with progress_bar(12, "cases", count=lambda: (5, "cases, 2 failed")):
        pass
    with progress_bar(None, "reading") as update:
        update(1, "fitting", 4)
    shown = capsys.readouterr().err
    assert all((words in shown) == terminal for words in ("3/3 letters", "5/12 cases, 2 failed", "1/4 fitting"))
    with progress_bar(3, "cases", show=False) as update:
        update(1)
    assert capsys.readouterr().err == ""
