"""Interrupted, a command says in one line what is kept, and leaves no worker behind."""

import os
import signal

import pytest
from analytic_simulator import AnalyticSimulator
from processes import members, python, wait_until

from capsbayes.interruption import Interrupted, keeping
from capsbayes.physics.build import CaseRunner
from capsbayes.run import Store, resumable

HANGS = """
import ctypes, sys
from functools import partial
from pathlib import Path
from capsbayes import cli
from capsbayes.interruption import keeping
from capsbayes.run import run_tasks

def hang(name):
    Path(name).touch()
    ctypes.PyDLL(None).sleep(1000)  # as compiled code does: it lets no other thread of the process run

def app(**how):
    with keeping(Path(sys.argv[1])):
        run_tasks([partial(hang, f"{sys.argv[1]}/{name}") for name in "abc"], None, 2)

cli.app = app
cli.main()
"""


@pytest.mark.parametrize(
    ("number", "everyone", "status"),
    [
        (signal.SIGINT, False, 130),
        (signal.SIGINT, True, 130),  # as a terminal does
        (signal.SIGTERM, False, 143),
        (signal.SIGTERM, True, 143),
        (signal.SIGKILL, False, -signal.SIGKILL),
    ],
)
def test_workers_that_hang_end_with_the_command(tmp_path, number, everyone, status):
    command = python("-c", HANGS, tmp_path)
    wait_until(lambda: len(list(tmp_path.iterdir())) == 2, command)
    (os.killpg if everyone else os.kill)(command.pid, number)
    _, said = command.communicate()
    assert command.returncode == status
    wait_until(lambda: not members(command.pid))
    if number != signal.SIGKILL:
        kept = f"finished work is kept in {tmp_path}"
        assert said == f"capsbayes: interrupted; {kept}; to go on: capsbayes {tmp_path}\n"


@pytest.mark.parametrize("interruption", [Interrupted(signal.SIGTERM), KeyboardInterrupt()])
def test_an_interruption_that_compiled_code_turned_into_an_error_is_one(tmp_path, interruption):
    """As numba's dispatcher does; a case must not be stored as failed for it, nor its steps be removed."""

    class Stopped(AnalyticSimulator):
        def run(self, **case):
            raise SystemError("returned a result with an exception set") from interruption

    store = Store.open(tmp_path / "parts", {})
    store.save("finished", {"value": 1.0})
    with pytest.raises(type(interruption)) as raised, keeping(store.folder):
        CaseRunner(Stopped(), store, 0.9).run(0.05, "rest")
    assert raised.value.__notes__ == [f"finished work is kept in {store.folder}"]
    assert list(store.names()) == ["finished"]


def test_nothing_is_said_to_be_kept_where_nothing_is(tmp_path):
    Store.open(tmp_path / "opened.parts", {})
    for folder in (tmp_path / "missing.parts", tmp_path / "opened.parts"):
        with pytest.raises(KeyboardInterrupt) as raised, keeping(folder):
            raise KeyboardInterrupt
        assert not hasattr(raised.value, "__notes__"), folder
    with pytest.raises(KeyboardInterrupt) as raised, resumable(tmp_path / "result"):
        raise KeyboardInterrupt
    assert not hasattr(raised.value, "__notes__")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_workers_that_have_not_started_yet_are_silent(tmp_path, number):
    command = python("-c", HANGS, tmp_path)
    wait_until(lambda: len(members(command.pid)) > 2, command)
    os.killpg(command.pid, number)
    _, said = command.communicate()
    assert command.returncode == 128 + number
    assert len(said.splitlines()) == 1
    wait_until(lambda: not members(command.pid))
