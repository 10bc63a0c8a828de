import json
import re

import cv2
import numpy as np
import pytest
from drawn import drawn
from drawn_film import bright, film, written
from typer.testing import CliRunner

from capsbayes.cli import app
from capsbayes.errors import InputError
from capsbayes.measurement import Measurement

EXPERIMENT = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 +/- 0.02 Pa s"\n'
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
    assert measured.outline.view == "silhouette"
    assert np.ptp(measured.outline.points[:, 0]) == pytest.approx(measured.axial_extent, abs=0.01)
    assert measured.capsule_velocity == pytest.approx(6.2e-3)
    assert measured.experiment_file == folder / "experiment.toml"
    outline = np.loadtxt(out / "outline.csv", delimiter=",", skiprows=1)
    assert np.ptp(outline[:, 0]) == pytest.approx(made.axial_extent, abs=0.5)
    canvas = cv2.imread(str(out / "overlay.png"))
    assert canvas.shape == (800, 4 * made.picture.shape[1], 3)
    assert np.any(canvas[:, :, 2].astype(int) - canvas[:, :, 1] > 100)  # the red outline


def test_a_flow_rate_is_kept_in_place_of_the_velocity(folder):
    folder, _ = folder
    rate = ("--flow-rate", "0.60 +/- 0.01 uL/min")
    assert run(folder, "capsule.png", *rate, "--out", str(folder / "m")).exit_code == 0
    measured = Measurement.read(folder / "m" / "measurement.toml")
    assert measured.capsule_velocity is None
    assert (measured.flow_rate, measured.flow_rate_error) == pytest.approx((1e-11, 1e-11 / 60.0))
    both = run(folder, "capsule.png", *rate, *VELOCITY, "--json")
    assert {"capsule_velocity", "flow_rate"} <= set(json.loads(both.output))
    neither = run(folder, "capsule.png")
    assert str(neither.exception).endswith("or --flow-rate, got nothing")


def test_a_batch_of_pictures_refuses_the_velocity_of_one(folder):
    folder, made = folder
    (folder / "pictures").mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / "pictures" / name), made.picture)
    words = ["batch", str(folder / "pictures"), "--experiment", str(folder / "experiment.toml")]
    refused = CliRunner().invoke(app, [*words, *VELOCITY, "--out", str(folder / "r.nc")])
    assert "expected one capsule, as each has a velocity of its own, got 2 pictures; give --flow-rate" in str(
        refused.exception
    )
    assert not (folder / "r.nc.parts").exists()
    exact = CliRunner().invoke(app, [*words, "--shared-velocity", "5 mm/s", "--out", str(folder / "r.nc")])
    assert str(exact.exception).startswith("--shared-velocity: expected a standard error")
    between = CliRunner().invoke(app, [*words, "--flow-rate", "0.5 .. 0.9 uL/min", "--out", str(folder / "r.nc")])
    assert str(between.exception).startswith("--flow-rate: expected a standard error, as in")


def test_an_empty_channel_ends_with_its_status(folder):
    folder, _ = folder
    out = folder / "m"
    result = run(folder, "empty.png", *VELOCITY, "--out", str(out))
    assert result.exit_code == 1
    assert "No capsule was found" in result.output
    assert (out / "overlay.png").exists()
    assert not (out / "measurement.toml").exists()


def test_walls_by_hand_are_printed_and_stored(folder):
    folder, made = folder
    result = run(folder, "capsule.png", *VELOCITY, "--walls", "44.5, 154.5 px", "--out", str(folder / "m"))
    assert result.exit_code == 0, result.output
    stated = "walls by hand at rows 44.5, 154.5 px, each +/- 1 px"
    assert stated in " ".join(result.output.split())
    measured = Measurement.read(folder / "m" / "measurement.toml")
    assert measured.walls == stated
    assert measured.axial_extent == pytest.approx(made.axial_extent / made.half_width, rel=0.01)
    assert measured.axial_extent_error > 0.01


def test_no_velocity_where_the_experiment_states_the_viscous_tension(folder):
    folder, _ = folder
    (folder / "experiment.toml").write_text(
        'cross_section = "square"\nhalf_width = "25 um"\nviscous_tension = "3 mN/m"\n'
    )
    result = run(folder, "capsule.png", "--out", str(folder / "m"))
    assert result.exit_code == 0, result.output
    assert Measurement.read(folder / "m" / "measurement.toml").capsule_velocity is None
    refused = run(folder, "capsule.png", *VELOCITY)
    assert isinstance(refused.exception, InputError)
    assert str(refused.exception).startswith("--velocity: expected none: the experiment states viscous_tension")


@pytest.mark.parametrize("velocity", ["6.2 mm/s", "6.2 +/- 0.1 mm", "fast"])
def test_a_velocity_without_unit_or_error_is_refused(folder, velocity):
    result = run(folder[0], "capsule.png", "--velocity", velocity)
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith("--velocity")


@pytest.fixture
def filmed(tmp_path):
    places = 65.0 + 23.37 * np.arange(5)
    written(tmp_path / "film", film(places))
    cv2.imwrite(str(tmp_path / "empty.png"), bright(x=places[0]).background)
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    return tmp_path


def test_a_film_becomes_one_file_for_each_capsule(filmed):
    out = filmed / "m"
    options = ("--frame-rate", "2000 Hz", "--background", str(filmed / "empty.png"), "--out", str(out))
    result = run(filmed, "film", *options)
    assert result.exit_code == 0, result.output
    assert "1 of 1 capsules measured" in result.output
    measured = Measurement.read(out / "capsule-1" / "measurement.toml")
    assert measured.capsule_velocity == pytest.approx(23.37 / 45.0 * 25e-6 * 2000.0, rel=2e-3)
    assert measured.capsule_velocity_error == pytest.approx(0.008 * measured.capsule_velocity, rel=0.1)
    assert (out / "capsule-1" / "overlay.png").exists()
    assert len((out / "capsule-1" / "frames.csv").read_text().splitlines()) == 6
    assert (out / "capsules.csv").read_text().splitlines()[1].startswith("1,DONE,5,5,2.19")


def test_the_rate_of_a_film_may_stand_in_the_experiment(filmed):
    empty = ("--background", str(filmed / "empty.png"))
    result = run(filmed, "film", *empty)
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith("measure: --frame-rate: expected the rate at which the film was taken")
    (filmed / "experiment.toml").write_text(EXPERIMENT + 'frame_rate = "2 kHz"\n')
    assert run(filmed, "film", *empty).exit_code == 0


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("film", ("--velocity", "6.20 +/- 0.06 mm/s")),
        ("empty.png", ("--frame-rate", "2 kHz")),
        ("points.csv", ("--background", "empty.png")),
        ("cells.rtdc", ("--edge-error", "0.1 um")),
        ("cells.rtdc", ("--walls", "10, 70")),
        ("points.csv", ("--crop", "0, 0, 50, 50")),
        ("points.csv", ("--contrast", "bright")),
    ],
)
def test_an_option_of_another_kind_of_input_is_refused(filmed, name, option):
    result = run(filmed, name, *option)
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith(f"measure: {option[0]}: expected one of --")


def test_a_contour_becomes_a_file_that_identify_reads(folder):
    folder, made = folder
    np.savetxt(folder / "c.csv", made.outline, delimiter=",", header="x_px,y_px", comments="")
    options = ("--pixel-size", "0.45 +/- 0.002 um", "--edge-error", "0.1 um", "--flow", "right")
    result = run(folder, "c.csv", *VELOCITY, *options, "--out", str(folder / "m"))
    assert result.exit_code == 0, result.output
    measured = Measurement.read(folder / "m" / "measurement.toml")
    assert measured.axial_extent == pytest.approx(0.45e-6 / 25e-6 * made.axial_extent, rel=1e-3)
    assert measured.outline.view == "silhouette"
    walls = ("--walls", "44.5, 154.5", "--wall-error", "0.5 px", "--flow", "right")
    assert run(folder, "c.csv", *VELOCITY, *walls, "--out", str(folder / "w")).exit_code == 0
    by_walls = Measurement.read(folder / "w" / "measurement.toml")
    assert by_walls.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 0.5 px"
    assert by_walls.axial_extent == pytest.approx(made.axial_extent / 55.0, rel=1e-3)


def test_an_upright_picture_is_turned_when_asked(folder):
    folder, made = folder
    cv2.imwrite(str(folder / "upright.png"), np.rot90(made.picture))
    refused = run(folder, "upright.png", *VELOCITY)
    assert refused.exit_code == 1
    assert "turn the picture by a quarter (--rotate 90)" in refused.output
    turned = run(folder, "upright.png", *VELOCITY, "--rotate", "90", "--out", str(folder / "m"))
    assert turned.exit_code == 0, turned.output
    measured = Measurement.read(folder / "m" / "measurement.toml")
    assert measured.axial_extent == pytest.approx(made.axial_extent / 55.0, abs=0.01)
    rows, columns = cv2.imread(str(folder / "m" / "overlay.png")).shape[:2]
    assert (rows, columns) == tuple(4 * size for size in made.picture.shape)


def test_a_file_of_unknown_kind_is_taken_for_what_its_first_bytes_say(folder):
    folder, _ = folder
    (folder / "capsule.dat").write_bytes((folder / "capsule.png").read_bytes())
    assert run(folder, "capsule.dat", *VELOCITY).exit_code == 0
    (folder / "other.dat").write_bytes(b"nothing that is known")
    result = run(folder, "other.dat", *VELOCITY)
    assert isinstance(result.exception, InputError)
    message = r"other\.dat: expected a file that shows a capsule: PNG, TIFF, .*, got one that is none of them"
    assert re.search(message, str(result.exception))


@pytest.mark.parametrize(("name", "message"), [("x.rtdc", "show to be PNG; rename it"), ("x.csv", "got zero bytes")])
def test_a_picture_by_another_name_is_named_before_its_options(folder, name, message):
    folder, _ = folder
    (folder / name).write_bytes((folder / "capsule.png").read_bytes())
    result = run(folder, name, *VELOCITY)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
