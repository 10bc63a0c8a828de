"""Processes apart: tasks with limits of time and of memory, and commands whose progress is seen."""

import asyncio

import pytest

from capsbayes.app import worker
from capsbayes.run import LINES, line_read, progress_bar

resource = pytest.importorskip("resource", reason="the system has no limits of a process")


@pytest.mark.parametrize("hard", [resource.RLIM_INFINITY, 2**60, 2**32])
def test_the_memory_is_limited_and_no_limit_is_raised(monkeypatch, hard):
    asked = []  # in place of a limit that the tests would keep
    monkeypatch.setattr(resource, "setrlimit", lambda *limits: asked.append(limits))
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (hard, hard))
    worker.limit_memory()
    least = worker.MOST_MEMORY if hard == resource.RLIM_INFINITY else min(worker.MOST_MEMORY, hard)
    assert asked == [(resource.RLIMIT_AS, (least, hard))]


@pytest.mark.parametrize("error", [ValueError("current limit exceeds maximum limit"), OSError(22, "Invalid argument")])
def test_a_system_that_refuses_the_limit_goes_on_without_it(monkeypatch, error):
    def refused(*limits):
        raise error

    monkeypatch.setattr(resource, "setrlimit", refused)
    worker.limit_memory()


@pytest.fixture
def started():
    process = worker.Worker("slow_tasks")
    yield process
    process.stop()


def test_tasks_take_their_time_once_the_process_is_ready_and_one_that_fails_leaves_room_for_the_next(started):
    assert asyncio.run(started.run("same", value=3, seconds=1.0)) == 3
    assert asyncio.run(started.run("same", value=4, seconds=1.0)) == 4
    with pytest.raises(worker.WorkFailedError, match=r"^cells\.rtdc: expected a rate, got none; give flow rate$"):
        asyncio.run(started.run("refused"))
    with pytest.raises(worker.WorkFailedError, match=r"This took longer than 0\.1 s and was stopped"):
        asyncio.run(started.run("slept", length=60.0, seconds=0.1))
    with pytest.raises(worker.WorkFailedError, match="the process that tried was ended"):
        asyncio.run(started.run("ended"))
    assert asyncio.run(started.run("same", value=5, seconds=5.0)) == 5


@pytest.mark.parametrize(
    ("words", "how", "status", "said"),
    [
        (["identify", "absent.toml"], {"limited": True}, 2, "absent.toml: expected a file, got nothing there"),
        (["--help"], {"seconds": 0.01}, 2, "This took longer than 0.01 s and was stopped."),
    ],
)
def test_what_a_command_prints_is_returned_and_one_that_takes_too_long_is_stopped(tmp_path, words, how, status, said):
    ended, printed = asyncio.run(worker.printed_by(words, tmp_path, **how))
    assert (ended, said in printed) == (status, True)


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
