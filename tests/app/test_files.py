"""What the bench computes and saves, without its page: the same files as the command line writes, byte for byte."""

import re
import shlex
import shutil
from pathlib import Path

import cv2
import pytest
from command_line import written
from drawn import drawn
from typer.testing import CliRunner

from capsbayes.app import identifying, measuring
from capsbayes.app.stated import EXAMPLE, Stated
from capsbayes.cli import app
from capsbayes.errors import CapsbayesError
from capsbayes.experiment import Experiment
from capsbayes.quantity import Quantity
from capsbayes.status import Status

ROOT = Path(__file__).parents[2]
EXPERIMENT = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 +/- 0.02 Pa s"\n'
STATED = Stated(
    "capsule.png", background="empty.png", velocity="6.20 +/- 0.06 mm/s", surface_shear_modulus="50 +/- 20 mN/m"
)


@pytest.fixture
def folder(tmp_path):
    made = drawn(0.08, 1.05, half_width=55.0)
    folder = tmp_path / "capsule"
    folder.mkdir()
    cv2.imwrite(str(folder / "capsule.png"), made.picture)
    cv2.imwrite(str(folder / "empty.png"), made.background)
    (folder / "experiment.toml").write_text(EXPERIMENT)
    return folder


def test_a_picture_is_shown_and_measured_before_anything_else_is_stated(folder):
    (folder / "experiment.toml").unlink()
    shown = measuring.shown(str(folder), "capsule.png")
    assert (shown["rows"], shown["columns"]) == (200, 200)
    assert shown["src"].startswith("data:image/png;base64,")
    found = measuring.measured(str(folder), Stated("capsule.png"))
    assert (found["ok"], found["flow"]) == (True, 1)
    upper, _, lower, _ = found["walls"]
    assert lower - upper == pytest.approx(110.0, abs=0.5)
    assert len(found["outline"]) > 50
    assert [row[0] for row in found["rows"]] == ["L<sub>z</sub>", "L<sub>a</sub>", "ℓ"]


def test_what_is_put_right_by_hand_is_measured_again(folder):
    by_hand = Stated("capsule.png", walls="44.0, 154.0", wall_error="2", crop="10, 20, 185, 160")
    found = measuring.measured(str(folder), by_hand)
    assert found["walls"] == pytest.approx([44.0, 44.0, 154.0, 154.0])
    assert (found["ok"], found["flow"]) == (True, 1)
    assert measuring.measured(str(folder), Stated("capsule.png", flow="left"))["status"] == str(Status.WRONG_FLOW)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        (Stated("capsule.png", walls="20"), "the rows of two walls"),
        (Stated("capsule.png", crop="0, 0, 900, 900"), "a part of the picture of 200 x 200 px"),
        (Stated("absent.png"), "nothing there"),
    ],
)
def test_a_mistake_is_one_line(folder, stated, message):
    with pytest.raises(CapsbayesError, match=message) as refused:
        measuring.measured(str(folder), stated)
    assert "\n" not in str(refused.value)


def test_a_beginner_sees_what_the_page_of_the_bench_promises(tmp_path):
    for name in ("capsule.png", "experiment.toml"):
        shutil.copy(ROOT / "examples" / "pictures" / name, tmp_path)
    page = (ROOT / "docs" / "app.md").read_text(encoding="utf-8")
    (promised,) = re.findall(r"^3\. Press \*\*Identify\*\*.*?\n\n", page, re.DOTALL | re.MULTILINE)
    stated = Stated("capsule.png", velocity="4.86 +/- 0.04 mm/s")
    whole, axial = (float(row[2].split()[0]) for row in measuring.measured(str(tmp_path), stated)["rows"][:2])
    assert f"$L_z$ is {whole:.3f} and $L_a$ {axial:.3f} half widths" in page
    found = identifying.identified(str(tmp_path), stated)
    headlines = " ".join(re.sub(r"<[^>]+>", "", line) for line in found["headlines"])
    numbers, said = ([float(text) for text in re.findall(r"\d+\.\d+", words)] for words in (headlines, promised))
    assert numbers[:3] == pytest.approx(said[:3], abs=0.11)
    assert numbers[3:] == pytest.approx(said[3:], abs=0.011)
    assert (len(said), found["ok"]) == (6, True)


def test_the_example_of_the_page_is_that_of_the_examples():
    kept = (ROOT / "src/capsbayes/app/example.png").read_bytes()
    assert kept == (ROOT / "examples/pictures/capsule.png").read_bytes()
    stated = Experiment.read(ROOT / "examples/pictures/experiment.toml")
    for name in ("half_width", "viscosity"):
        assert Quantity.of(EXAMPLE[name]) == getattr(stated, name)


@pytest.mark.slow
def test_the_saved_files_are_those_of_the_command_line_byte_for_byte(folder, tmp_path, monkeypatch):
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    saved = identifying.saved(str(folder), STATED)
    for line in STATED.commands(other)[1:]:
        monkeypatch.chdir(other)
        result = CliRunner().invoke(app, shlex.split(line)[1:])
        assert result.exit_code == 0, result.output
    assert set(saved) == written(folder) == written(other)
    assert {"posterior.nc", "report.html", "measurement.toml", "overlay.png"} < set(saved)
    for name in saved:
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
