"""The worker processes of pytest: one that has grown ends after its file, and another takes its place.

A process keeps the functions that were compiled in it and the databases that were opened, and the whole suite has more
of them than a small machine has memory. The peak of each worker is printed and has a bound; and the tests that ran are
counted, because xdist knows of workers that crash, but not of workers that make room.
"""

import ctypes
import gc
import resource
import sys

import psutil
import pytest
from xdist.scheduler import LoadFileScheduling

GROWN = 0.7
"""GB after a file, above which a worker makes room for a new one."""
MOST = 1.5
"""GB at the peak of a worker; the whole suite in one process (``-n0``) may take more."""


class Worker:
    """Plugin of a worker."""

    def __init__(self):
        self.peak, self.at = 0.0, ""

    def pytest_collection_finish(self):
        give_back()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        done = yield
        if resident() > GROWN:
            give_back()
        if nextitem is None or nextitem.path != item.path:
            if (peak := peak_memory()) > self.peak:
                self.peak, self.at = peak, item.path.name
            give_back()
            stopped = item.session.shouldstop or item.session.shouldfail
            if nextitem is not None and not stopped and resident() > GROWN:
                item.config.workeroutput["makes_room"] = True
                item.session.shouldstop = "to make room"
        return done

    def pytest_sessionfinish(self, session):
        output = session.config.workeroutput
        output["peak_memory"] = max(self.peak, peak_memory()), self.at
        if output.get("makes_room"):
            output["shouldstop"] = False  # else xdist would stop the others, too


class Controller:
    """Plugin of the process that runs the workers."""

    def __init__(self):
        self.peaks, self.ran, self.missing = {}, set(), 0

    def pytest_xdist_make_scheduler(self, config, log):
        return Rescheduling(config, log) if config.getvalue("dist") == "loadfile" else None

    def pytest_testnodedown(self, node):
        output = getattr(node, "workeroutput", {})  # none of one that crashed
        if "peak_memory" in output:
            self.peaks[node.gateway.id] = output["peak_memory"]
        if makes_room(node):
            running = node.config.pluginmanager.getplugin("dsession")
            if not running.shouldstop:
                running.shuttingdown = False  # which xdist may have begun while the worker ended
                running._clone_node(node)
            node.gateway.exit()

    def pytest_runtest_logreport(self, report):
        if report.when == "teardown":
            self.ran.add(report.nodeid)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session, exitstatus):
        self.missing = session.testscollected - len(self.ran) if exitstatus == pytest.ExitCode.OK else 0
        if self.missing or any(peak > MOST for peak, _ in self.peaks.values()):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        for name, (peak, at) in self.peaks.items():
            terminalreporter.write_line(f"Peak memory of {name}: {peak:.2f} GB of at most {MOST} GB, in {at}")
        if self.missing:
            terminalreporter.write_line(f"{self.missing} tests were collected, but did not run", red=True)


class Rescheduling(LoadFileScheduling):
    """Gives the files that a worker left to the next one."""

    def remove_node(self, node):
        if not makes_room(node):
            return super().remove_node(node)
        left = {file: tests for file, tests in self.assigned_work.pop(node).items() if not all(tests.values())}
        self.workqueue.update(left)
        for file in left:
            self.workqueue.move_to_end(file, last=False)
        for other in self.nodes:
            self._reschedule(other)
        return None

    def _reschedule(self, node):
        if node in self.registered_collections:  # else it is new, and asks again when it has collected the tests
            super()._reschedule(node)


def makes_room(node):
    return getattr(node, "workeroutput", {}).get("makes_room", False)


def resident():
    """Return the resident memory of this process in GB."""
    return psutil.Process().memory_info().rss / 1e9


def give_back():
    """Forget models that are kept for later, and give freed memory back to the system where its C library can do so."""
    kept = sys.modules.get("capsbayes.surrogate.surrogate")
    for name in ("joint_surrogate", "corrected_membrane", "plain_membrane"):
        if kept is not None:
            getattr(kept, name).cache_clear()
    gc.collect()
    if hasattr(library := ctypes.CDLL(None), "malloc_trim"):
        library.malloc_trim(0)


def peak_memory():
    """Return the largest resident memory of this process so far in GB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


def register(config):
    """Give a process of pytest its part."""
    if hasattr(config, "workerinput"):
        config.pluginmanager.register(Worker())
    elif config.pluginmanager.hasplugin("dsession"):
        config.pluginmanager.register(Controller())
