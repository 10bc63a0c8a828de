"""Every example script runs and prints the number it should."""

from __future__ import annotations

import importlib.util
import json
import re
import runpy
import sys
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pytest

from capsbayes import Simulator, build_database

EXAMPLES = Path(__file__).parents[1] / "examples"
REAL = "tube_capsule/tube_capsule.py"  # which needs a picture that is not part of the library: tests/image/test_tube.py
SCRIPTS = sorted({path.relative_to(EXAMPLES).as_posix() for path in EXAMPLES.rglob("*.py")} - {REAL})

NUMBERS = {
    "own_law/own_law.py": ("v_o/U", 1.416, 0.002),
    "own_effect/own_effect.py": ("breadth/l", 1.739, 0.0005),
    "pictures/pictures.py": ("G_s [mN/m]", 50.0, 0.02),
    "film/film.py": ("G_s [mN/m]", 50.0, 0.02),
    "batch/batch.py": ("G_s [mN/m]", 50.0, 0.05),
    "drifting_modulus/drifting_modulus.py": ("G_s [mN/m]", 50.0, 0.15),  # its inflation is known to a tenth
}
"""For each script a name that it prints before an equals sign, its true value, and the relative tolerance."""
SLOW = {"drifting_modulus/drifting_modulus.py"}  # a diagnosis


@cache
def printed_by(script):
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as printed:
        patch.setattr(sys, "argv", [script])
        runpy.run_path(str(EXAMPLES / script), run_name="__main__")
    return printed.getvalue()


@pytest.mark.parametrize("script", [pytest.param(one, marks=[pytest.mark.slow] * (one in SLOW)) for one in SCRIPTS])
def test_an_example_prints_its_number(script):
    name, value, tolerance = NUMBERS[script]
    printed = re.search(rf"^{re.escape(name)} = (\S+)$", printed_by(script), re.MULTILINE)
    assert printed is not None
    assert float(printed[1]) == pytest.approx(value, rel=tolerance)


def test_a_law_of_ones_own_makes_a_database_that_states_it(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("own_law", EXAMPLES / "own_law" / "own_law.py")
    own_law = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "own_law", own_law)  # where pickle looks for the law's class
    spec.loader.exec_module(own_law)
    simulator = Simulator(law=own_law.EvansSkalak(4.0), refinement=4)
    database = build_database(simulator, [(0.05, 0.8)], out=tmp_path / "own.nc", scheduler="synchronous")
    assert list(database["status"]) == ["DONE"]
    assert database.settings["law"] == "Evans-Skalak K = 4.0"


@pytest.mark.slow
def test_the_drift_of_the_example_goes_with_the_effect():
    printed = printed_by("drifting_modulus/drifting_modulus.py")
    truth = json.loads((EXAMPLES / "drifting_modulus" / "truth.json").read_text())
    low, high = map(float, re.search(r"alpha = \S+ \[(\S+), (\S+)\]", printed).groups())
    middle = 0.5 * (low + high)
    assert abs(middle - truth["size"]) < high - low  # two standard errors
    rows = np.array([line.split() for line in printed.splitlines() if re.fullmatch(r"[\d. ]+", line)], dtype=float)
    assert np.all(np.diff(rows[:, 1]) < 0.0)
    assert np.ptp(np.log(rows[:, 1])) > 2.0 * np.ptp(np.log(rows[:, 2]))


@pytest.mark.slow
def test_the_pictures_are_what_their_script_draws(tmp_path, monkeypatch):
    """To one grey level in a few pixels, as the transforms of other machines round otherwise."""
    monkeypatch.setattr(sys, "argv", ["pictures.py", "--out", str(tmp_path)])
    runpy.run_path(str(EXAMPLES / "pictures" / "pictures.py"), run_name="__main__")
    assert (tmp_path / "truth.toml").read_text() == (EXAMPLES / "pictures" / "truth.toml").read_text()
    for name in ("capsule.png", "empty.png"):
        drawn, kept = (cv2.imread(str(folder / name), 0).astype(int) for folder in (tmp_path, EXAMPLES / "pictures"))
        assert np.mean(np.abs(drawn - kept)) < 0.05
    assert {path.name for path in tmp_path.iterdir()} == {
        path.name for path in (EXAMPLES / "pictures").iterdir() if path.is_file()
    } - {"pictures.py"}
