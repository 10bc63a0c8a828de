"""Give each worker process of pytest one thread, print its memory, mark the numerical tests, and count skipped ones."""

import os
from collections import Counter
from pathlib import Path

import pytest

NUMERICAL = ("diagnosis", "infer", "plan", "surrogate", "test_least_squares.py")
ROUNDING_CANNOT_REACH = (  # of the folders above: interrupted work, texts, files, and errors a thousand times larger
    "infer/many/test_identify_folder.py",
    "infer/test_posterior_file.py",
    "infer/test_prior.py",
    "surrogate/test_caveats.py",
)

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is first imported
    os.environ.setdefault(name, "1")
# read when a worker process starts: glibc then gives arrays of some megabytes back to the system once they are free
os.environ |= {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": str(2**22)}


def pytest_collection_modifyitems(items):
    for item in items:
        file = item.path.relative_to(Path(__file__).parent)
        if file.parts[0] in NUMERICAL and file.as_posix() not in ROUNDING_CANNOT_REACH:
            item.add_marker(pytest.mark.numerical)


def pytest_sessionstart(session):
    import workers  # which needs numpy to be told of one thread before

    workers.register(session.config)


def pytest_terminal_summary(terminalreporter):
    reasons = Counter(str(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", ()))
    for reason, number in reasons.most_common():
        terminalreporter.write_line(f"{number} skipped: {reason.removeprefix('Skipped: ')}")
