"""Every test runs once, and the peak memory of each worker process is printed."""

import os
import subprocess
import sys
from pathlib import Path

SUPPORT = Path(__file__).parent / "support"


def test_the_peak_of_each_worker_is_printed_with_its_file(tmp_path):
    (tmp_path / "conftest.py").write_text(
        "def pytest_sessionstart(session):\n    import workers\n    workers.register(session.config)\n"
    )
    for number in range(4):
        (tmp_path / f"test_{number}.py").write_text("def test_one(): pass\n")
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "loadfile", "-p", "no:cacheprovider", "-v"]
    environment = os.environ | {"PYTHONPATH": str(SUPPORT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.count("PASSED")) == (0, 4), done.stdout
    assert done.stdout.count(" GB, in test_") == 2
