import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from capsbayes.cli import app
from capsbayes.errors import InputError
from capsbayes.measurement import Measurement

sys.path.insert(0, str(Path(__file__).parents[1] / "image"))  # for the drawn pictures

from drawn import drawn

EXPERIMENT = 'section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 +/- 0.02 Pa s"\n'
VELOCITY = ("--velocity", "6.20 +/- 0.06 mm/s")


@pytest.fixture
def folder(tmp_path):
    made = drawn(0.08, 1.05, half_width=55.0)
    cv2.imwrite(str(tmp_path / "capsule.png"), made.picture)
    cv2.imwrite(str(tmp_path / "empty.png"), made.background)
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    return tmp_path, made


def run(folder, picture, *options):
    experiment = ("--experiment", str(folder / "experiment.toml"))
    return CliRunner().invoke(app, ["measure", str(folder / picture), *experiment, *options])


def test_a_picture_becomes_a_file_that_identify_reads(folder):
    folder, made = folder
    out = folder / "m"
    result = run(folder, "capsule.png", *VELOCITY, "--background", str(folder / "empty.png"), "--out", str(out))
    assert result.exit_code == 0, result.output
    assert "L_a" in result.output
    assert "Status: Done." in result.output
    measured = Measurement.read(out / "measurement.toml")
    truth = np.array([made.axial_extent, made.axial_length]) / made.half_width
    np.testing.assert_allclose(measured.lengths, truth, atol=0.01)
    assert measured.capsule_velocity == pytest.approx(6.2e-3)
    assert measured.experiment_file == folder / "experiment.toml"
    outline = np.loadtxt(out / "outline.csv", delimiter=",", skiprows=1)
    assert np.ptp(outline[:, 0]) == pytest.approx(made.axial_extent, abs=0.5)
    canvas = cv2.imread(str(out / "overlay.png"))
    assert canvas.shape == (800, 4 * made.picture.shape[1], 3)
    assert np.any(canvas[:, :, 2].astype(int) - canvas[:, :, 1] > 100)  # the red outline


def test_an_empty_channel_ends_with_its_status(folder):
    folder, _ = folder
    out = folder / "m"
    result = run(folder, "empty.png", *VELOCITY, "--out", str(out))
    assert result.exit_code == 1
    assert "No capsule was found" in result.output
    assert (out / "overlay.png").exists()
    assert not (out / "measurement.toml").exists()


@pytest.mark.parametrize("velocity", ["6.2 mm/s", "6.2 +/- 0.1 mm", "fast"])
def test_a_velocity_without_unit_or_error_is_refused(folder, velocity):
    result = run(folder[0], "capsule.png", "--velocity", velocity)
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith("--velocity")
