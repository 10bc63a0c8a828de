"""The process apart that computes tasks: its limits of time, and of memory where the system has one."""

import asyncio

import pytest

from capsbayes.app import worker

resource = pytest.importorskip("resource", reason="the system has no limits of a process")


@pytest.fixture
def asked(monkeypatch):
    """What is asked of the system in place of a limit that the tests would keep."""
    calls = []
    monkeypatch.setattr(resource, "setrlimit", lambda *limits: calls.append(limits))
    return calls


@pytest.mark.parametrize("hard", [resource.RLIM_INFINITY, 2**60, 2**32])
def test_the_memory_is_limited_and_no_limit_is_raised(asked, monkeypatch, hard):
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


def test_the_time_of_a_task_begins_once_the_process_is_ready(started):
    assert asyncio.run(started.run("same", value=3, seconds=1.0)) == 3
    assert asyncio.run(started.run("same", value=4, seconds=1.0)) == 4


def test_a_task_that_takes_too_long_or_ends_its_process_is_refused_and_the_next_one_is_computed(started):
    with pytest.raises(worker.WorkFailedError, match=r"This took longer than 0\.1 s and was stopped"):
        asyncio.run(started.run("slept", length=60.0, seconds=0.1))
    with pytest.raises(worker.WorkFailedError, match="the process that tried was ended"):
        asyncio.run(started.run("ended"))
    assert asyncio.run(started.run("same", value=5, seconds=5.0)) == 5


def test_a_refusal_is_told_in_the_words_of_the_page(started):
    with pytest.raises(worker.WorkFailedError, match=r"^cells\.rtdc: expected a rate, got none; give flow rate$"):
        asyncio.run(started.run("refused"))
