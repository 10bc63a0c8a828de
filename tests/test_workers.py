"""Worker processes that have grown make room for others, and no test is lost; their memory has a bound."""

import os
import subprocess
import sys
from pathlib import Path

SUPPORT = Path(__file__).parent / "support"
FILES, TESTS = 5, 2


def run(folder, **limits):
    """Run some files of tests in two workers with limits in GB; exit status and what is printed."""
    stated = "\n    ".join(f"workers.{name} = {value}" for name, value in limits.items())
    (folder / "conftest.py").write_text(
        f"def pytest_sessionstart(session):\n    import workers\n    {stated}\n    workers.register(session.config)\n"
    )
    for number in range(FILES):
        of = 1 if number % 2 else TESTS
        text = f"import pytest\n@pytest.mark.parametrize('n', range({of}))\ndef test_one(n): pass\n"
        (folder / f"test_{number}.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "loadfile", "-p", "no:cacheprovider", "-v"]
    environment = os.environ | {"PYTHONPATH": str(SUPPORT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def test_a_worker_that_has_grown_makes_room_after_its_file_and_every_test_runs_once(tmp_path):
    status, printed = run(tmp_path, GROWN=0.0)
    assert status == 0, printed
    number = FILES // 2 + (FILES + 1) // 2 * TESTS
    assert f"{number} passed" in printed
    assert printed.count("PASSED") == number
    assert printed.count("Peak memory of gw") > 2


def test_a_worker_above_its_bound_fails_the_run(tmp_path):
    status, printed = run(tmp_path, MOST=0.001)
    assert (status, printed.count("Peak memory of gw")) == (1, 2)
