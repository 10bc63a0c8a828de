"""Commands that the bench runs as processes of their own, and what it sees of their progress."""

import asyncio

from capsbayes.app.command import printed_by
from capsbayes.run import LINES, line_read, progress_bar


def test_a_command_is_watched_and_what_it_prints_is_returned(tmp_path):
    status, printed = asyncio.run(printed_by(["identify", "absent.toml"], tmp_path, limited=True))
    assert (status, "absent.toml: expected a file, got nothing there" in printed) == (2, True)


def test_a_command_that_takes_too_long_is_stopped(tmp_path):
    status, printed = asyncio.run(printed_by(["--help"], tmp_path, seconds=0.01))
    assert (status, printed) == (2, "This took longer than 0.01 s and was stopped.")


def test_a_program_that_asks_for_lines_reads_how_much_is_done(monkeypatch, capsys):
    with progress_bar(3, "capsules") as update:
        update(1)
    assert capsys.readouterr().err == ""
    monkeypatch.setenv(LINES, "lines")
    with progress_bar(3, "capsules") as update:
        update(1)
        update(3)
    with progress_bar(None, "rows", count=lambda: (7, "rows")):
        pass
    lines = capsys.readouterr().err.splitlines()
    assert [line_read(line) for line in lines] == [(1.0, 3.0, "capsules"), (3.0, 3.0, "capsules"), (7.0, None, "rows")]
