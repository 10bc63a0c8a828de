"""Give each worker process of pytest one thread, bound its memory, mark the numerical tests, and count skipped ones."""

import os
import resource
import sys
from collections import Counter
from pathlib import Path

import pytest

NUMERICAL = ("diagnosis", "infer", "plan", "surrogate", "test_least_squares.py")
ROUNDING_CANNOT_REACH = (  # of the folders above: interrupted work, texts, files, and errors a thousand times larger
    "infer/many/test_identify_folder.py",
    "infer/many/one_membrane/test_measured.py",
    "infer/test_inputs.py",
    "infer/test_posterior_file.py",
    "infer/test_prior.py",
    "surrogate/test_caveats.py",
    "surrogate/test_off_nodes.py",
)

MOST_MEMORY = 1.5
"""GB that a worker process may take; the whole suite in one process (``-n0``) may take more."""
peaks = {}  # of the workers, in the process that runs them

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is first imported
    os.environ.setdefault(name, "1")


def pytest_collection_modifyitems(items):
    for item in items:
        file = item.path.relative_to(Path(__file__).parent)
        if file.parts[0] in NUMERICAL and file.as_posix() not in ROUNDING_CANNOT_REACH:
            item.add_marker(pytest.mark.numerical)


def pytest_sessionfinish(session):
    if hasattr(session.config, "workeroutput"):
        kilo = 1 if sys.platform == "darwin" else 1024
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * kilo
        session.config.workeroutput["peak_memory"] = peak / 1e9
    elif any(peak > MOST_MEMORY for peak in peaks.values()):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    if hasattr(node, "workeroutput"):  # not of one that crashed
        peaks[node.gateway.id] = node.workeroutput["peak_memory"]


def pytest_terminal_summary(terminalreporter):
    reasons = Counter(str(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", ()))
    for reason, number in reasons.most_common():
        terminalreporter.write_line(f"{number} skipped: {reason.removeprefix('Skipped: ')}")
    for name, peak in sorted(peaks.items()):
        terminalreporter.write_line(f"Peak memory of {name}: {peak:.2f} GB of at most {MOST_MEMORY} GB")
