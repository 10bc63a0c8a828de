"""The worker processes of pytest: they give memory back after each file of tests, and their peaks are bounded."""

import ctypes
import gc
import resource
import sys

import pytest

MOST = 2.0  # GB, of a run without slow tests, which takes 1.5


class Worker:
    """Plugin of a worker."""

    def __init__(self):
        self.peak, self.at = 0.0, ""

    def pytest_collection_finish(self):
        give_back()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        done = yield
        if nextitem is None or nextitem.path != item.path:
            if (peak := peak_memory()) > self.peak:
                self.peak, self.at = peak, item.path.name
            give_back()
        return done

    def pytest_sessionfinish(self, session):
        session.config.workeroutput["peak_memory"] = max(self.peak, peak_memory()), self.at


class Controller:
    """Plugin of the process that runs the workers."""

    def __init__(self, config):
        self.most = MOST if sys.platform == "linux" and config.option.markexpr == "not slow" else float("inf")
        self.peaks = {}

    def pytest_testnodedown(self, node):
        output = getattr(node, "workeroutput", {})  # none of one that crashed
        if "peak_memory" in output:
            self.peaks[node.gateway.id] = output["peak_memory"]

    def pytest_sessionfinish(self, session):
        if session.exitstatus == pytest.ExitCode.OK and any(peak > self.most for peak, _ in self.peaks.values()):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        for name, (peak, at) in self.peaks.items():
            failed = f": the run fails, as it is more than {self.most} GB" if peak > self.most else ""
            terminalreporter.write_line(f"Peak memory of {name}: {peak:.2f} GB, in {at}{failed}")


def give_back():
    """Forget models that are kept for later, and give freed memory back to the system where its C library can do so."""
    for module in [module for name, module in sys.modules.items() if name.startswith("capsbayes.")]:
        for kept in vars(module).values():
            if hasattr(kept, "cache_clear"):
                kept.cache_clear()
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
        config.pluginmanager.register(Controller(config))
