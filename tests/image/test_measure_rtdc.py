"""Events of .rtdc files: a drawn one, and the recordings that come with the format's reference reader."""

import io
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run, written
from drawn import circle
from typer.testing import CliRunner

from capsbayes.cli import app, measuring
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.measure import write_detection
from capsbayes.image.rtdc import RtdcFile, measure_rtdc
from capsbayes.infer.outline import aligned_with
from capsbayes.measurement import Measurement
from capsbayes.profile import signed_area
from capsbayes.quantity import Quantity
from capsbayes.status import Status
from evidence.synthetic import Optics, Scene, draw

h5py = pytest.importorskip("h5py")
pytest.importorskip("hdf5plugin")

FOLDER = Path(__file__).parents[3] / "shared" / "data" / "rtdc"
EXPERIMENT = Experiment(cross_section="square", half_width=10e-6, viscosity=0.015)
PIXEL = Quantity(0.34e-6, 0.003e-6, "m")
SPEED = Quantity(0.15, 0.005, "m/s")
recorded = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the recordings are not in {FOLDER}")


def events(path, pixel=PIXEL, axis=None):
    return list(measure_rtdc(path, EXPERIMENT, shared_velocity=SPEED, pixel_size=pixel, axis=axis))


@pytest.fixture
def path(tmp_path):
    half_width = 10.0 / 0.34
    drawings = [
        draw(Scene(circle(0.6), circle(0.6), half_width, (80, 160), centre=(x, 39.5)), Optics(), seed=1)
        for x in (40.0, 80.3, 120.0)
    ]
    yy, xx = np.mgrid[:80, :160]
    masks = [np.hypot(xx - one.scene.middle[0], yy - 39.5) < 0.6 * half_width for one in drawings]
    masks[2][:, 118:121] = False
    made = tmp_path / "drawn.rtdc"
    with h5py.File(made, "w") as file:
        file.attrs["imaging:pixel size"], file.attrs["setup:channel width"] = 0.34, 20.0
        file["events/image"] = np.stack([one.picture for one in drawings])
        file["events/mask"] = 255 * np.stack(masks).astype(np.uint8)
    return made


@pytest.mark.parametrize(
    ("flash", "speed", "stated", "refused"),
    [(2.0, 0.15, None, False), (2.0, 1.5, None, True), (2.0, 1.5, "100 ns", False), (None, 1.5, None, False)],
)
def test_events_that_smear_during_the_flash_are_refused(path, flash, speed, stated, refused):
    """Two microseconds at 0.15 m/s are 0.9 px, at 1.5 m/s 8.8 px; an exposure that is stated overrules the file."""
    with h5py.File(path, "a") as file:
        if flash is not None:
            file.attrs["imaging:flash duration"] = flash
    known = replace(EXPERIMENT, exposure=stated)
    velocity = Quantity(speed, 0.01 * speed, "m/s")
    found = [
        event.measurement.status for event in measure_rtdc(path, known, shared_velocity=velocity, pixel_size=PIXEL)
    ]
    assert found[:2] == [Status.SMEARED if refused else Status.DONE] * 2
    assert found[2] is Status.BROKEN_MASK


def test_sizes_that_a_file_declares_are_checked_before_it_is_read(path):
    whole = {"dtype": np.uint8, "chunks": (1, 80, 160)}
    for declared, message in (
        ({"shape": (3, 20_000, 20_000)} | whole, "events/image: expected at most 4 million pixels, got 20000 x 20000"),
        ({"shape": (10**9, 80, 160)} | whole, "expected pictures of all 1000000000 events, got those of 0"),
        ({"shape": (3, 80, 160), "dtype": np.uint8}, "expected pictures of all 3 events, got those of 0"),
        (
            {"shape": (3, 80, 160), "maxshape": (None, 80, 160)} | whole | {"chunks": (10**5, 80, 160)},
            r"expected chunks of at most 256 MiB, got \(100000, 80, 160\)",
        ),
        ({"data": np.zeros((3, 80, 160))}, "expected grey pictures of all events, in one array of integers, got "),
        ({"data": np.zeros((3, 80, 80), np.uint8)}, "events/mask: expected masks of 80 x 80, got 160 x 80"),
        ({"data": h5py.SoftLink("/events/image")}, "expected .* got (nothing|a file that cannot be read as one)"),
    ):
        with h5py.File(path, "a") as file:
            del file["events/image"]
            if isinstance(declared.get("data"), h5py.SoftLink):
                file["events/image"] = declared["data"]
            else:
                file.create_dataset("events/image", **declared)
        with pytest.raises(InputError, match=message):
            RtdcFile.open(path)


def test_drawn_spheres_and_a_mask_in_two_pieces(path):
    found = events(path)
    assert [event.detection.status for event in found] == [Status.DONE, Status.DONE, Status.BROKEN_MASK]
    for event in found[:2]:
        seen = event.measurement
        assert abs(seen.axial_extent - 1.2) < 2.5 * seen.axial_extent_error
        assert seen.axial_extent_error > 0.003 / 0.34 * 1.2
        assert event.row()["axial_extent_m"] == pytest.approx(seen.axial_extent * 10e-6)
        assert event.row()["axial_extent_error_m"] == pytest.approx(seen.axial_extent_error * 10e-6, rel=0.01)
        assert seen.axial_length is None
    assert np.isnan(found[2].measurement.axial_extent)
    assert found[1].picture.source.endswith("drawn.rtdc, event 1")


def test_walls_that_are_not_seen_are_not_invented(path):
    with h5py.File(path, "a") as file:
        pictures = file["events/image"][:]
        inside = pictures[:, 18:62]  # far from the walls, whose lines are at 10 and 69
        file["events/image"][:] = np.pad(inside, ((0, 0), (18, 18), (0, 0)), mode="edge")
    with pytest.raises(InputError, match=r"events/image: expected two dark walls 59 px apart, .* \(--axis\)"):
        events(path)
    found = events(path, axis="39.5")[0].measurement
    assert abs(found.axial_extent - 1.2) < 2.5 * found.axial_extent_error


def test_events_have_the_silhouette_of_a_picture(path, tmp_path):
    """A sphere does not tell the flow: it is stated. The error of the pixel moves all points of the edge alike."""
    how = {"shared_velocity": SPEED, "pixel_size": PIXEL}
    assert [event.measurement.outline for event in measure_rtdc(path, EXPERIMENT, **how)] == [None] * 3
    for event in list(measure_rtdc(path, EXPERIMENT, **how, flow="right"))[:2]:
        event.measurement.write(tmp_path / "measurement.toml")
        outline = Measurement.read(tmp_path / "measurement.toml").outline
        assert outline.view == "silhouette"
        truth = circle(0.6)
        _, feet = aligned_with(outline.points, truth if signed_area(truth) > 0.0 else truth[::-1])
        assert abs(feet.distance.mean()) < 2.5 * outline.pose.offset
        assert outline.pose.offset > 0.9 * 0.6 * 0.003 / 0.34
        assert feet.distance.std() < 3.0 * outline.noise.scale


def shorten(file, name, kind=None):
    kept = file[name][:] if kind else file[name][:-1]
    del file[name]
    file[name] = kept.astype(kind or kept.dtype)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"setup:channel width": None}, "setup:channel width: expected a positive number"),
        ({"imaging:pixel size": 0.68}, "pixel size: expected about the 0.68 um"),
        ({"setup:channel width": 30.0}, "half_width: expected half of the 30 um"),
        ({"imaging:pixel size": 0.0}, "positive number of micrometres, got 0.0$"),
        ({"experiment:event count": 999}, "image: expected those of all 999 events, got"),
        (lambda file: file.pop("events/mask"), "events/mask: expected pictures and masks, got nothing"),
        (
            lambda file: shorten(file, "events/mask"),
            "events/mask: expected those of all 3 events, got 2; export the fi",
        ),
        (lambda file: shorten(file, "events/image"), "events/image: expected those of all 3 events, got 2"),
        (lambda file: shorten(file, "events/image", float), "in one array of integers, got float64 of "),
    ],
)
def test_what_a_file_lacks_is_named(path, spoil, message):
    with h5py.File(path, "a") as file:
        for key, value in spoil.items() if isinstance(spoil, dict) else ():
            file.attrs.pop(key) if value is None else file.attrs.update({key: value})
        if not isinstance(spoil, dict):
            spoil(file)
    with pytest.raises(InputError, match=message) as caught:
        events(path)
    assert "\n" not in str(caught.value)


def test_a_flow_rate_is_that_of_every_event_and_needs_an_error(path):
    with pytest.raises(InputError, match=r'flow rate: .*got nothing; give --flow-rate "0.16 \+/- ERROR uL/s", or --'):
        list(measure_rtdc(path, EXPERIMENT, pixel_size=PIXEL))
    with h5py.File(path, "a") as file:
        file.attrs["setup:flow rate"] = 0.04
    assert RtdcFile.open(path).flow_rate == pytest.approx(0.04e-9)
    with pytest.raises(InputError, match=r'got 0.04 uL/s without an error; give --flow-rate "0.04 \+/- ERROR uL/s"'):
        list(measure_rtdc(path, EXPERIMENT, pixel_size=PIXEL))
    stated = {"pixel_size": PIXEL, "flow_rate": "40 +/- 1 nL/s"}
    found = [event.measurement for event in measure_rtdc(path, EXPERIMENT, **stated)]
    assert [seen.status.ok for seen in found] == [True, True, False]
    for seen in found[:2]:
        assert seen.capsule_velocity is None
        assert (seen.flow_rate, seen.flow_rate_error) == pytest.approx((4e-11, 1e-12))
    smeared = replace(EXPERIMENT, exposure="20 us")  # 0.1 m/s: 2 um, 5.9 px
    assert next(measure_rtdc(path, smeared, **stated)).measurement.status is Status.SMEARED


def test_one_velocity_for_all_events_is_refused_and_another_flow_rate_than_that_of_the_file_is_said(path, tmp_path):
    EXPERIMENT.write(tmp_path / "experiment.toml")
    words = ["measure", str(path), "--experiment", str(tmp_path / "experiment.toml"), "--pixel-size", "0.34(1) um"]
    refused = CliRunner().invoke(app, [*words, "--velocity", "150 +/- 5 mm/s"])
    assert "--velocity: expected one capsule, as each has a velocity of its own, got the events" in str(
        refused.exception
    )
    both = CliRunner().invoke(app, [*words, "--velocity", "1(1) mm/s", "--shared-velocity", "1(1) mm/s"])
    assert isinstance(both.exception, InputError)
    with h5py.File(path, "a") as file:
        file.attrs["setup:flow rate"] = 0.06
    told = CliRunner().invoke(app, [*words, "--flow-rate", "0.04 +/- 0.001 uL/s"])
    assert "The file states a flow rate of 0.06 uL/s; the 0.04 uL/s of --flow-rate are used." in told.output
    other = CliRunner().invoke(app, [*words, "--flow-rate", "0.04 +/- 0.001 uL/min"])
    assert str(other.exception).startswith("flow rate: expected about the 0.06 uL/s of ")
    batch = ["batch", str(path), "--flow-rate", "0.04 +/- 0.001 uL/s", "--out", str(tmp_path / "r.nc")]
    assert "expected its capsules measured before, in the folder" in str(CliRunner().invoke(app, batch).exception)


def test_a_file_that_is_no_hdf5_is_refused(tmp_path):
    (tmp_path / "cells.rtdc").write_bytes(b"no HDF5")
    with pytest.raises(InputError, match=r"expected an \.rtdc file"):
        RtdcFile.open(tmp_path / "cells.rtdc")
    with pytest.raises(InputError, match="nothing there"):
        RtdcFile.open(tmp_path / "none.rtdc")


def test_an_interrupted_run_goes_on_with_the_next_part(path, tmp_path, monkeypatch):
    counted = []

    def interrupted(folder, *rest):
        counted.append(folder.name)
        if len(counted) == 2:
            raise KeyboardInterrupt
        write_detection(folder, *rest)

    monkeypatch.setattr(measuring, "_PART", 1)
    monkeypatch.setattr(sys.modules["capsbayes.image.measure"], "write_detection", interrupted)  # not the function
    EXPERIMENT.write(tmp_path / "experiment.toml")
    words = ["measure", str(path), "--experiment", str(tmp_path / "experiment.toml"), "--out", str(tmp_path / "made")]
    words += ["--shared-velocity", "150 +/- 5 mm/s", "--pixel-size", "0.34 +/- 0.003 um"]
    for _ in range(2):
        result = CliRunner().invoke(app, words)
    assert counted == ["event-0", "event-1", "event-1", "event-2"]
    assert "Status: 2 of 3 events measured." in result.output
    whole = pd.DataFrame([event.row() for event in events(path)])
    kept = pd.read_csv(tmp_path / "made" / "events.csv")
    pd.testing.assert_frame_equal(kept, pd.read_csv(io.StringIO(whole.to_csv(index=False))))
    assert written(tmp_path / "made") == {"events.csv", "event-0", "event-1", "event-2"}


@recorded
def test_recorded_beads_are_round_and_the_last_event_is_not():
    """The channel is tilted by 2.4 degrees; 46 beads, then something else."""
    found = events(FOLDER / "calibration_beads_47.rtdc")
    assert all(event.detection.status is Status.DONE for event in found)
    assert np.degrees(found[0].detection.walls.tilt) == pytest.approx(-2.4, abs=0.1)
    ratios = []
    for event in found:
        outline, walls = event.detection.outline, event.detection.walls
        ratios.append(event.detection.lengths[0] / np.ptp(outline.points @ walls.across))
    assert np.max(np.abs(np.array(ratios[:-1]) - 1.0)) < 0.03
    assert ratios[-1] > 1.2


@recorded
def test_recorded_doublets_and_broken_masks_are_refused_by_name():
    cells = events(FOLDER / "blood_rbc_leukocytes.rtdc")
    refused = {event.number for event in cells if event.detection.status in (Status.DOUBLET, Status.LOPSIDED)}
    assert {3, 4, 5} <= refused  # red cells that overlap, as the pictures show
    assert {1, 2, 8, 9, 10, 12} <= {event.number for event in cells if event.detection.status.ok}
    path, pixel = FOLDER / "mask_with_artefact.rtdc", replace(PIXEL, value=0.68e-6)
    with pytest.raises(InputError, match="two dark walls 29 px apart"):  # its dark lines are 33 px apart
        events(path, pixel)
    broken = events(path, pixel, axis="20")
    assert Counter(event.detection.status for event in broken) == {Status.BROKEN_MASK: 10}


def test_a_file_without_events_is_one_line_and_leaves_nothing(path, tmp_path, monkeypatch, capsys):
    with h5py.File(path, "a") as file:
        for name in ("image", "mask"):
            del file[f"events/{name}"]
            file[f"events/{name}"] = np.zeros((0, 80, 160), np.uint8)
    EXPERIMENT.write(tmp_path / "experiment.toml")
    words = ("measure", path, "--experiment", tmp_path / "experiment.toml", "--shared-velocity", "0.15 +/- 0.005 m/s")
    status, _, complaint = run(
        monkeypatch, capsys, *map(str, words), "--pixel-size", "0.34 +/- 0.003 um", "--out", str(tmp_path / "made")
    )
    assert (status, "events: expected at least one event, got none" in complaint) == (2, True)
    assert not (tmp_path / "made").exists()
