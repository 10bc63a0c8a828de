"""The files that open the bench by a double click: they install once, again after an update, and start the same."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FAKE = """#!/bin/sh
echo "$(basename "$0") $*" >> "$LOG"
if [ "$2" = venv ]; then mkdir -p .bench/bin; cp "$0" .bench/bin/python; fi
"""
INSTALLED = ["python3.13 -m venv .bench", "python -m pip install --quiet .[app]"]


@pytest.mark.skipif(os.name != "posix", reason="a file of Windows' shell does it there")
def test_the_first_double_click_and_that_after_an_update_install_and_every_one_opens_the_bench(tmp_path):
    folder, log, path = tmp_path / "my capsbayes", tmp_path / "log", tmp_path / "path"
    folder.mkdir()
    path.mkdir()
    (path / "python3.13").write_text(FAKE)
    (path / "python3.13").chmod(0o755)
    shutil.copy(ROOT / "bench.command", folder)
    project = folder / "pyproject.toml"
    project.touch()
    env = os.environ | {"PATH": f"{path}:{os.environ['PATH']}", "LOG": str(log)}
    opens = "python -m capsbayes app --port 0"
    for expected in ([*INSTALLED, opens], [opens], [*INSTALLED, opens]):
        log.unlink(missing_ok=True)
        subprocess.run([folder / "bench.command", "--port", "0"], env=env, cwd=tmp_path, check=True)
        assert log.read_text().splitlines() == expected
        done = (folder / ".bench" / "installed").stat().st_mtime
        os.utime(project, (done - 10.0,) * 2 if expected != [opens] else (done + 10.0,) * 2)


def test_windows_is_given_the_same_steps():
    text = (ROOT / "bench.bat").read_bytes().decode("ascii")
    assert text.count("\r\n") == text.count("\n")
    steps = [" ".join(step.split()) for step in re.findall(r"-m ((?:venv|pip|capsbayes)[^|\r]*)", text)]
    assert steps == ["venv .bench", "venv .bench", 'pip install --quiet ".[app]"', "capsbayes app %*"]
    for label in re.findall(r"goto (\w+)", text):
        assert f"\r\n:{label}\r\n" in text
