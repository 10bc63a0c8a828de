"""The process apart that computes tasks: its limit of memory, where the system has one."""

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
