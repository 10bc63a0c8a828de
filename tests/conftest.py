"""Give each of pytest's worker processes one thread, and mark the numerical tests."""

import os
from pathlib import Path

import pytest

NUMERICAL = ("diagnosis", "infer", "plan", "surrogate", "test_least_squares.py")

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is first imported
    os.environ.setdefault(name, "1")


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.relative_to(Path(__file__).parent).parts[0] in NUMERICAL:
            item.add_marker(pytest.mark.numerical)
