"""Commands that tests start, wait for and kill with their workers; patient, since machines may be slow."""

import os
import signal
import subprocess
import sys
import time

import psutil

PATIENCE = 900.0
"""Seconds until a test gives up; far beyond what anything takes."""


def python(*arguments, **how):
    """Start Python with what this process can import, as leader of a group of processes that hears SIGINT."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | how
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=environment,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # a job in the background has none
        **how,
    )


def capsbayes(*arguments, program="from capsbayes.cli import main; main()", **how):
    """Start a command, perhaps by a program that prepares it."""
    return python("-c", program, *arguments, **how)


def wait_until(holds, process=None):
    """Wait until a condition holds; fail when the process has ended before, or after a long time."""
    end = time.monotonic() + PATIENCE
    while not holds():
        assert process is None or process.poll() is None, f"ended too early: {process.communicate()}"
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.01)


def members(group):
    """Return the living processes of a group."""
    found = []
    for process in psutil.process_iter(["pid", "status"]):
        try:
            if os.getpgid(process.pid) == group and process.info["status"] != psutil.STATUS_ZOMBIE:
                found.append(process)
        except (ProcessLookupError, psutil.Error):
            continue
    return found
