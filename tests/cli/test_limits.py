"""Full disks, and the time and memory that a refusal takes, in processes of their own."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn import drawn
from matplotlib import font_manager

MAIN = """
import atexit
from pathlib import Path

def keep_peak():  # of this process alone: the system also counts what the tests held when they started it
    peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    Path(".peak").write_text(peak.split()[1])

atexit.register(keep_peak)
from capsbayes.cli import main
main()
"""


def ended(here, words, largest_file):
    """Run a command under limits: exit status, lines of standard error, processor time [s], memory [bytes]."""

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30, 4 * 2**30))
        if largest_file is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))

    with (here / ".err").open("w+b") as err:
        run = subprocess.Popen(
            [sys.executable, "-c", MAIN, *words.split()],
            cwd=here,
            stdout=subprocess.DEVNULL,
            stderr=err,
            preexec_fn=limit,
        )
        _, status, used = os.wait4(run.pid, 0)
        run.returncode = os.waitstatus_to_exitcode(status)
    lines = (here / ".err").read_text().splitlines()
    return run.returncode, lines, used.ru_utime + used.ru_stime, 1024 * int((here / ".peak").read_text())


FILLING = (
    "identify capsule.toml --engine quadrature --out made",
    "report posterior.nc --out made.html",
    "atlas database.nc --out made",
)
REFUSED = (
    "measure huge.png --experiment experiment.toml --velocity 6.2+/-0.06mm/s",
    "identify nested.toml",
    "simulate --ca 0.05 --size-ratio 0.9 --refinement 1000",
    "hide --effect none --out made --workers 0",
)


@pytest.mark.parametrize("words", FILLING)
def test_a_full_disk_ends_in_one_line_and_leaves_nothing(here, words):
    font_manager.findfont("STIXGeneral")  # writes the list of fonts, which the limit would cut off
    before = {path.name for path in here.iterdir()} | {".err", ".peak"}
    status, lines, _, _ = ended(here, words, 2000)
    assert status == 2, lines
    assert len(lines) == 1, lines
    assert lines[0].startswith("capsbayes: ")
    assert {path.name for path in here.iterdir()} == before


@pytest.mark.parametrize("words", REFUSED)
def test_a_refusal_takes_little_time_and_memory(here, words):
    status, lines, seconds, memory = ended(here, words, None)
    assert status == 2, lines
    assert len(lines) == 1, lines
    assert seconds < 5.0
    assert memory < 1e9


@pytest.mark.slow
def test_the_largest_picture_is_measured_in_a_gigabyte(here):
    made = drawn(0.08, 1.05)
    seen, empty = (cv2.resize(grey, None, fx=2.0, fy=2.0) for grey in (made.picture, made.background))
    around = np.repeat(empty[:, :1], (2**23 // len(seen) - seen.shape[1]) // 2, axis=1)
    cv2.imwrite(str(here / "large.png"), np.hstack([around, seen, around]))
    words = "measure large.png --experiment experiment.toml --velocity 6.2+/-0.06mm/s --out made"
    status, lines, _, memory = ended(here, words, None)
    assert (status, lines) == (0, [])
    assert memory < 1e9
    assert (here / "made" / "overlay.png").exists()


def test_where_nothing_can_be_written_numba_keeps_its_functions_in_a_folder_of_the_process(tmp_path):
    code = "import os; os.access = lambda *_: False; import capsbayes.infer.likelihood"
    code += "; print(os.environ['NUMBA_CACHE_DIR'])"
    clean = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | {"TMPDIR": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=clean, check=True)
    assert Path(run.stdout.strip()).parent == tmp_path
    assert not list(tmp_path.iterdir())
    assert run.stderr.count("\n") == 1
    assert "set NUMBA_CACHE_DIR" in run.stderr
