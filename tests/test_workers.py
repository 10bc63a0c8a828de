"""Every test runs once; the peak memory of each worker process is printed, and fails a run where it is too large."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parent / "support"


def run(folder, most):
    (folder / "conftest.py").write_text(
        f"import workers\nworkers.MOST = {most}\ndef pytest_sessionstart(session): workers.register(session.config)\n"
    )
    for number in range(4):
        (folder / f"test_{number}.py").write_text("def test_one(): pass\n")
    options = ["-n", "2", "--dist", "loadfile", "-p", "no:cacheprovider", "-v", "-m", "not slow"]
    command, environment = [sys.executable, "-m", "pytest", *options], os.environ | {"PYTHONPATH": str(SUPPORT)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_peak_of_each_worker_is_printed_with_its_file(tmp_path):
    done = run(tmp_path, most=64.0)
    assert (done.returncode, done.stdout.count("PASSED")) == (0, 4), done.stdout
    assert done.stdout.count(" GB, in test_") == 2
    assert "the run fails" not in done.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="peaks are bounded on Linux alone")
def test_a_peak_that_is_too_large_fails_the_run(tmp_path):
    done = run(tmp_path, most=0.001)
    assert (done.returncode, done.stdout.count("PASSED")) == (1, 4), done.stdout
    assert done.stdout.count("the run fails, as it is more than 0.001 GB") == 2
