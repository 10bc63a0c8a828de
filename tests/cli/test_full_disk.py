"""Commands on a disk that is full, or that is read only: one line, exit status 2, and nothing but whole files."""

import shutil
import subprocess
from dataclasses import replace

import cv2
import pytest
from analytic_simulator import AnalyticSimulator
from command_line import run
from drawn import drawn
from drawn_film import bright, film, written
from sessions import EXPERIMENT, drawn_session

import capsbayes.physics.simulator
from capsbayes import Surrogate
from capsbayes.diagnosis import Session
from capsbayes.files.output_file import RECORD
from capsbayes.infer.batch import identify_folder

VELOCITY = ("--velocity", "6.2 +/- 0.06 mm/s")
FULL = "expected room on the disk, got No space left on device; make room and start again: what is finished is kept"
READ_ONLY = "expected a folder that can be written, got Read-only file system"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with a picture, a film, cases, and a set of capsules."""
    folder = tmp_path_factory.mktemp("inputs")
    cv2.imwrite(str(folder / "picture.png"), drawn(0.08, 1.05).picture)
    cv2.imwrite(str(folder / "empty.png"), bright(x=65.0).background)
    written(folder / "film", film([65.0, 105.0, 145.0, 185.0]))
    (folder / "cases.csv").write_text("capillary_number,size_ratio\n0.05,0.9\n0.06,0.9\n")
    EXPERIMENT.write(folder / "experiment.toml")
    capsules = drawn_session(Surrogate.open("square-neo-hookean"), 24, seed=7)[0].measurements
    Session([replace(capsule, flow_rate=None) for capsule in capsules], EXPERIMENT).write(folder / "set.csv")
    return folder


@pytest.fixture(scope="module")
def population(inputs):
    how = {"scheduler": "synchronous", "progress": False}
    model = Surrogate.open("square-neo-hookean")
    identify_folder(inputs / "set.csv", model, EXPERIMENT, out=inputs / "population.nc", seed=1, **how)
    return inputs / "population.nc"


@pytest.fixture
def disk(tmp_path, inputs, monkeypatch):
    """A function that makes a small disk, perhaps with a population on it, perhaps read only."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(*options):
        return subprocess.run(["mount", *options, str(folder)], capture_output=True, check=False).returncode == 0

    def make(kilobytes, *, population=None, read_only=False):
        if not shutil.which("mount") or not mount("-t", "tmpfs", "-o", f"size={kilobytes}k", "none"):
            pytest.skip("no disk can be mounted here")
        if population is not None:
            shutil.copy(population, folder / "population.nc")
        assert not read_only or mount("-o", "remount,ro")
        return folder

    monkeypatch.chdir(inputs)
    yield make
    subprocess.run(["umount", str(folder)], capture_output=True, check=False)


OF_FILM = ["--background", "empty.png", "--frame-rate", "2000 Hz"]
OF_CASES = ["--cases", "cases.csv", "--scheduler", "synchronous"]
PARTS = ["size-0.9_ca-0.05_from-rest.DONE.part", "size-0.9_ca-0.06_from-0.05.DONE.part"]
EXPERIMENT_FILE = ["--experiment", "experiment.toml"]
USES = {  # command line, size of the disk [kB], what is kept
    "measure a picture": (["measure", "picture.png", *VELOCITY, *EXPERIMENT_FILE, "--out", "{disk}/made"], 20, []),
    "measure a film": (["measure", "film", *OF_FILM, *EXPERIMENT_FILE, "--out", "{disk}/made"], 40, []),
    "build, no part": (["build", *OF_CASES, "--out", "{disk}/made.nc"], 4, []),
    "build, all parts": (["build", *OF_CASES, "--out", "{disk}/made.nc"], 32, ["settings.json", *PARTS]),
    "batch": (["batch", "set.csv", *EXPERIMENT_FILE, "--scheduler", "synchronous", "--out", "{disk}/made.nc"], 12, []),
    "population": (["population", "{disk}/population.nc"], 160, ["population.nc"]),
    "diagnose": (["diagnose", "set.csv", *EXPERIMENT_FILE, "--out", "{disk}/made"], 20, []),
}
SLOW = ("batch", "population", "diagnose")


def ended(monkeypatch, capsys, use, folder):
    """Return exit status and lines of standard error of a command that writes on a disk."""
    monkeypatch.setattr(capsbayes.physics.simulator, "Simulator", lambda **_: AnalyticSimulator(), raising=False)
    status, _, err = run(monkeypatch, capsys, *(word.format(disk=folder) for word in USES[use][0]))
    return status, err.splitlines()


@pytest.mark.parametrize("use", [pytest.param(use, marks=[pytest.mark.slow] * (use in SLOW)) for use in USES])
def test_a_full_disk(request, disk, monkeypatch, capsys, use):
    _, size, kept = USES[use]
    folder = disk(size, population=request.getfixturevalue("population") if use == "population" else None)
    status, lines = ended(monkeypatch, capsys, use, folder)
    assert status == 2
    assert [line.split(": ", 2)[2] for line in lines] == [FULL]
    left = [path for path in folder.rglob("*") if path.is_file() and path.name != RECORD]
    steps = [path for path in left if path.parent.suffix == ".steps"]  # of slow machines: finished, to go on from
    assert sorted(path.name for path in left if path not in steps) == sorted(kept)
    assert all(path.suffix == ".part" for path in steps)


@pytest.mark.parametrize("use", USES)
def test_a_read_only_folder(inputs, disk, monkeypatch, capsys, use):
    folder = disk(400, population=inputs / "set.csv", read_only=True)
    before = list(folder.rglob("*"))
    assert ended(monkeypatch, capsys, use, folder) == (2, [f"capsbayes: {folder}: {READ_ONLY}"])
    assert list(folder.rglob("*")) == before
