import json
from functools import cache

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


@cache
def made():
    return drawn(0.08, 1.05, half_width=55.0)


@pytest.fixture
def folder(tmp_path):
    cv2.imwrite(str(tmp_path / "capsule.png"), made().picture)
    cv2.imwrite(str(tmp_path / "empty.png"), made().background)
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    return tmp_path


def run(folder, picture, *options):
    experiment = ("--experiment", str(folder / "experiment.toml"))
    return CliRunner().invoke(app, ["measure", str(folder / picture), *experiment, *options])


def measured(folder, picture, *options):
    """Measure a picture, which must end well; return the measurement and what is printed, in one line."""
    result = run(folder, picture, *options, "--out", str(folder / "m"))
    assert result.exit_code == 0, result.output
    return Measurement.read(folder / "m" / "measurement.toml"), " ".join(result.output.split())


def refusal(folder, picture, *options):
    error = run(folder, picture, *options).exception
    assert isinstance(error, InputError)
    return str(error)


def test_a_picture_becomes_a_file_that_identify_reads(folder):
    seen, printed = measured(folder, "capsule.png", *VELOCITY, "--background", str(folder / "empty.png"))
    assert "L_a" in printed
    assert "Status: Done." in printed
    np.testing.assert_allclose(seen.lengths, np.array([made().axial_extent, made().axial_length]) / 55.0, atol=0.01)
    assert seen.outline.view == "silhouette"
    assert np.ptp(seen.outline.points[:, 0]) == pytest.approx(seen.axial_extent, abs=0.01)
    assert seen.capsule_velocity == pytest.approx(6.2e-3)
    assert seen.experiment_file == folder / "experiment.toml"
    outline = np.loadtxt(folder / "m" / "outline.csv", delimiter=",", skiprows=1)
    assert np.ptp(outline[:, 0]) == pytest.approx(made().axial_extent, abs=0.5)
    canvas = cv2.imread(str(folder / "m" / "overlay.png"))
    assert canvas.shape == (800, 4 * made().picture.shape[1], 3)
    assert np.any(canvas[:, :, 2].astype(int) - canvas[:, :, 1] > 100)  # the red outline


def test_a_flow_rate_is_kept_in_place_of_the_velocity(folder):
    rate = ("--flow-rate", "0.60 +/- 0.01 uL/min")
    seen, _ = measured(folder, "capsule.png", *rate)
    assert seen.capsule_velocity is None
    assert (seen.flow_rate, seen.flow_rate_error) == pytest.approx((1e-11, 1e-11 / 60.0))
    both = run(folder, "capsule.png", *rate, *VELOCITY, "--json")
    assert {"capsule_velocity", "flow_rate"} <= set(json.loads(both.output))
    assert refusal(folder, "capsule.png").endswith("or --flow-rate, got nothing")


def test_a_batch_of_pictures_refuses_the_velocity_of_one(folder):
    (folder / "pictures").mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / "pictures" / name), made().picture)
    words = ["batch", str(folder / "pictures"), "--experiment", str(folder / "experiment.toml")]
    for options, message in (
        (VELOCITY, "expected one capsule, as each has a velocity of its own, got 2 pictures; give --flow-rate"),
        (("--shared-velocity", "5 mm/s"), "--shared-velocity: expected a standard error"),
        (("--flow-rate", "0.5 .. 0.9 uL/min"), "--flow-rate: expected a standard error, as in"),
    ):
        refused = CliRunner().invoke(app, [*words, *options, "--out", str(folder / "r.nc")])
        assert message in str(refused.exception)
    assert not (folder / "r.nc.parts").exists()


def test_an_empty_channel_ends_with_its_status(folder):
    result = run(folder, "empty.png", *VELOCITY, "--out", str(folder / "m"))
    assert (result.exit_code, "No capsule was found" in result.output) == (1, True)
    assert (folder / "m" / "overlay.png").exists()
    assert not (folder / "m" / "measurement.toml").exists()


def test_walls_by_hand_are_printed_and_stored(folder):
    seen, printed = measured(folder, "capsule.png", *VELOCITY, "--walls", "44.5, 154.5 px")
    assert seen.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 1 px"
    assert seen.walls in printed
    assert seen.axial_extent == pytest.approx(made().axial_extent / 55.0, rel=0.01)
    assert seen.axial_extent_error > 0.01


def test_no_velocity_where_the_experiment_states_the_viscous_tension(folder):
    stated = 'cross_section = "square"\nhalf_width = "25 um"\nviscous_tension = "3 mN/m"\n'
    (folder / "experiment.toml").write_text(stated)
    assert measured(folder, "capsule.png")[0].capsule_velocity is None
    message = "--velocity: expected none: the experiment states viscous_tension"
    assert refusal(folder, "capsule.png", *VELOCITY).startswith(message)


@pytest.mark.parametrize("velocity", ["6.2 mm/s", "6.2 +/- 0.1 mm"])
def test_a_velocity_without_unit_or_error_is_refused(folder, velocity):
    assert refusal(folder, "capsule.png", "--velocity", velocity).startswith("--velocity")


@pytest.fixture
def filmed(tmp_path):
    places = 65.0 + 23.37 * np.arange(5)
    written(tmp_path / "film", film(places))
    cv2.imwrite(str(tmp_path / "empty.png"), bright(x=places[0]).background)
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    return tmp_path


def test_a_film_becomes_one_file_for_each_capsule(filmed):
    out, empty = filmed / "m", ("--background", str(filmed / "empty.png"))
    result = run(filmed, "film", "--frame-rate", "2000 Hz", *empty, "--out", str(out))
    assert result.exit_code == 0, result.output
    assert "1 of 1 capsules measured" in result.output
    seen = Measurement.read(out / "capsule-1" / "measurement.toml")
    assert seen.capsule_velocity == pytest.approx(23.37 / 45.0 * 25e-6 * 2000.0, rel=2e-3)
    assert seen.capsule_velocity_error == pytest.approx(0.008 * seen.capsule_velocity, rel=0.1)
    assert (out / "capsule-1" / "overlay.png").exists()
    assert len((out / "capsule-1" / "frames.csv").read_text().splitlines()) == 6
    assert (out / "capsules.csv").read_text().splitlines()[1].startswith("1,DONE,5,5,2.19")
    assert refusal(filmed, "film", *empty).startswith("measure: --frame-rate: expected the rate at which the film was")
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
    assert refusal(filmed, name, *option).startswith(f"measure: {option[0]}: expected one of --")


def test_a_contour_becomes_a_file_that_identify_reads(folder):
    np.savetxt(folder / "c.csv", made().outline, delimiter=",", header="x_px,y_px", comments="")
    scale = ("--pixel-size", "0.45 +/- 0.002 um", "--edge-error", "0.1 um", "--flow", "right")
    seen, _ = measured(folder, "c.csv", *VELOCITY, *scale)
    assert seen.axial_extent == pytest.approx(0.45e-6 / 25e-6 * made().axial_extent, rel=1e-3)
    assert seen.outline.view == "silhouette"
    walls = ("--walls", "44.5, 154.5", "--wall-error", "0.5 px", "--flow", "right")
    by_walls, _ = measured(folder, "c.csv", *VELOCITY, *walls)
    assert by_walls.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 0.5 px"
    assert by_walls.axial_extent == pytest.approx(made().axial_extent / 55.0, rel=1e-3)


def test_an_upright_picture_is_turned_when_asked(folder):
    cv2.imwrite(str(folder / "upright.png"), np.rot90(made().picture))
    refused = run(folder, "upright.png", *VELOCITY)
    assert (refused.exit_code, "turn the picture by a quarter (--rotate 90)" in refused.output) == (1, True)
    seen, _ = measured(folder, "upright.png", *VELOCITY, "--rotate", "90")
    assert seen.axial_extent == pytest.approx(made().axial_extent / 55.0, abs=0.01)
    rows, columns = cv2.imread(str(folder / "m" / "overlay.png")).shape[:2]
    assert (rows, columns) == tuple(4 * size for size in made().picture.shape)


def test_a_file_is_what_its_first_bytes_say(folder):
    picture = (folder / "capsule.png").read_bytes()
    for name, content, message in (
        ("other.dat", b"nothing that is known", "other.dat: expected a file that shows a capsule: PNG, TIFF, "),
        ("x.rtdc", picture, "show to be PNG; rename it"),
        ("x.csv", picture, "got zero bytes"),
    ):
        (folder / name).write_bytes(content)
        assert message in refusal(folder, name, *VELOCITY)
    (folder / "capsule.dat").write_bytes(picture)
    assert run(folder, "capsule.dat", *VELOCITY).exit_code == 0
