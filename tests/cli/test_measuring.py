"""The command ``measure``: files that `identify` reads, and what it prints."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import written

from capsbayes import Measurement

PICTURES = Path(__file__).parents[2] / "examples" / "pictures"
LEGEND = 4 * (800 // 36)  # px: two lines below the picture
MOVING = ("--velocity", "6.20 +/- 0.06 mm/s")
WALLS = ("--walls", "44.5, 154.5", "--wall-error", "0.5 px", "--flow", "right")


@pytest.fixture
def measure(here, capsbayes):
    """A function that measures; exit status and what is printed in one line."""

    def measure(name, *options, experiment="experiment.toml"):
        status, out, err = capsbayes("measure", name, "--experiment", experiment, *options)
        return status, " ".join((out + err).split())

    return measure


@pytest.fixture
def measured(measure):
    """A function that measures what must end well; the measurement."""

    def measured(*words, **how):
        status, printed = measure(*words, "--out", "m", **how)
        assert status == 0, printed
        return Measurement.read("m/measurement.toml")

    return measured


def test_a_picture_becomes_a_file_that_identify_reads(here, measure, picture):
    status, printed = measure("picture.png", *MOVING, "--background", "empty.png", "--out", "m")
    assert (status, "L_a" in printed, "Status: Done." in printed) == (0, True, True)
    seen = Measurement.read("m/measurement.toml")
    np.testing.assert_allclose(seen.lengths, np.array([picture.axial_extent, picture.axial_length]) / 55.0, atol=0.01)
    assert seen.outline.view == "silhouette"
    assert np.ptp(seen.outline.points[:, 0]) == pytest.approx(seen.axial_extent, abs=0.01)
    assert seen.capsule_velocity == pytest.approx(6.2e-3)
    assert seen.experiment_file == here / "experiment.toml"
    outline = np.loadtxt("m/outline.csv", delimiter=",", skiprows=1)
    assert np.ptp(outline[:, 0]) == pytest.approx(picture.axial_extent, abs=0.5)
    canvas = cv2.imread("m/overlay.png")
    assert canvas.shape == (800 + LEGEND, 4 * picture.picture.shape[1], 3)
    assert np.any(canvas[:, :, 2].astype(int) - canvas[:, :, 1] > 100)  # the red outline


def test_a_flow_rate_is_kept_in_place_of_the_velocity(measure, measured):
    rate = ("--flow-rate", "0.60 +/- 0.01 uL/min")
    seen = measured("picture.png", *rate)
    assert seen.capsule_velocity is None
    assert (seen.flow_rate, seen.flow_rate_error) == pytest.approx((1e-11, 1e-11 / 60.0))
    assert {"capsule_velocity", "flow_rate"} <= set(json.loads(measure("picture.dat", *rate, *MOVING, "--json")[1]))


def test_an_empty_channel_ends_with_its_status(measure):
    status, printed = measure("empty.png", *MOVING, "--out", "m")
    assert (status, "No capsule was found" in printed) == (1, True)
    assert Path("m/overlay.png").exists()
    assert not Path("m/measurement.toml").exists()


def test_walls_by_hand_are_printed_and_stored(measure, measured, picture):
    seen = measured("picture.png", *MOVING, "--walls", "44.5, 154.5 px")
    assert seen.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 1 px"
    assert seen.walls in measure("picture.png", *MOVING, "--walls", "44.5, 154.5 px")[1]
    assert seen.axial_extent == pytest.approx(picture.axial_extent / 55.0, rel=0.01)
    assert seen.axial_extent_error > 0.01


def test_a_stated_gamma_is_used_printed_and_stored(measured, measure, picture):
    cv2.imwrite("rooted.png", np.rint(np.sqrt(255.0 * picture.picture)).astype(np.uint8))
    linear, seen = measured("picture.png", *MOVING), measured("rooted.png", *MOVING, "--gamma", "2.0")
    assert seen.axial_extent == pytest.approx(linear.axial_extent, abs=0.001)
    assert "the light to the power of 1/2, as stated" in seen.doubt
    assert seen.doubt in measure("rooted.png", *MOVING, "--gamma", "2.0")[1]
    assert measured("rooted.png", *MOVING).doubt == linear.doubt == ""


def test_no_velocity_where_the_experiment_states_the_viscous_tension(measured):
    assert measured("picture.png", experiment="tension.toml").capsule_velocity is None


def test_an_upright_picture_is_turned_when_asked(measure, measured, picture):
    status, printed = measure("upright.png", *MOVING)
    assert (status, "turn the picture by a quarter (--rotate 90)" in printed) == (1, True)
    assert measured("upright.png", *MOVING, "--rotate", "90").axial_extent == pytest.approx(
        picture.axial_extent / 55.0, abs=0.01
    )
    rows, columns = (4 * size for size in picture.picture.shape)
    assert cv2.imread("m/overlay.png").shape[:2] == (rows + LEGEND, columns)


def test_a_film_becomes_one_file_for_each_capsule(measure):
    film = ("film", "--background", "film.png")
    status, printed = measure(*film, "--frame-rate", "2000 Hz", "--out", "m")
    assert (status, "1 of 1 capsules measured" in printed) == (0, True)
    seen = Measurement.read("m/capsule-1/measurement.toml")
    assert seen.capsule_velocity == pytest.approx(23.37 / 45.0 * 25e-6 * 2000.0, rel=2e-3)
    assert seen.capsule_velocity_error == pytest.approx(0.008 * seen.capsule_velocity, rel=0.1)
    assert Path("m/capsule-1/overlay.png").exists()
    assert len(Path("m/capsule-1/frames.csv").read_text().splitlines()) == 6
    assert Path("m/capsules.csv").read_text().splitlines()[1].startswith("1,DONE,5,5,2.19")
    with Path("experiment.toml").open("a") as file:
        file.write('frame_rate = "2 kHz"\n')
    status, printed = measure(*film, "--json")
    assert (status, [row["status"] for row in json.loads(printed)["capsules"]]) == (0, ["DONE"])


def test_events_as_json(measure):
    stated = ("--flow-rate", "0.5625 +/- 0.006 uL/min", "--pixel-size", "0.680 +/- 0.006 um", "--json")
    printed = measure(PICTURES / "cells.rtdc", *stated, experiment=PICTURES / "experiment.toml")[1]
    assert json.loads(printed)["statuses"] == {"DONE": 3}


def test_a_contour_becomes_a_file_that_identify_reads(measure, measured, picture):
    scale = ("--pixel-size", "0.45 +/- 0.002 um", "--edge-error", "0.1 um", "--flow", "right")
    seen = measured("contour.csv", *MOVING, *scale)
    assert seen.axial_extent == pytest.approx(0.45e-6 / 25e-6 * picture.axial_extent, rel=1e-3)
    assert seen.outline.view == "silhouette"
    by_walls = measured("contour.csv", *MOVING, *WALLS)
    assert by_walls.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 0.5 px"
    assert by_walls.axial_extent == pytest.approx(picture.axial_extent / 55.0, rel=1e-3)
    status, printed = measure("contour.csv", *MOVING, *WALLS, "--json")
    record = json.loads(printed)
    assert (status, record["status"]) == (0, "DONE")
    assert record["axial_extent"]["value"] == pytest.approx(by_walls.axial_extent, rel=1e-6)


def test_nothing_is_printed_when_it_is_quiet(measure):
    assert measure("contour.csv", *MOVING, *WALLS, "--quiet", "--out", "quiet") == (0, "")
    assert "measurement.toml" in written(Path("quiet"))
