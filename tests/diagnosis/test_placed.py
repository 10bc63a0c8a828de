"""Outlines and lengths of another unit or direction: one clear line, wherever they are read."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import run
from sessions import drawn_session

from capsbayes import Measurement, Session, diagnose
from capsbayes.errors import InputError, NoShapeError
from capsbayes.measurement import MeasuredOutline, OutlineNoise, check_placed
from capsbayes.measurement_sets import write_set

PLACED = {
    "in um": (lambda points: 25.0 * points, "expected points over l, some"),
    "flow to the left": (lambda points: points * [-1.0, 1.0], "expected the flow towards larger z"),
    "y and z swapped": (lambda points: points[:, ::-1], "expected z, along the flow, in the first column"),
}


@pytest.fixture(scope="module")
def outlined(model):
    return drawn_session(model, 6, seed=3, outline=True)[0]


def placed(session, place):
    outlines = [replace(seen.outline, points=place(seen.outline.points)) for seen in session.measurements]
    return [replace(seen, outline=outline) for seen, outline in zip(session.measurements, outlines, strict=True)]


@pytest.mark.parametrize("name", PLACED)
def test_outlines_of_another_unit_or_direction_are_one_line(outlined, tmp_path, name):
    """Read as one file, as `identify` does, and as a set, as diagnose, batch and membrane do; and in Python."""
    place, message = PLACED[name]
    measurements = placed(outlined, place)
    for path in (tmp_path / "set", tmp_path / "set.nc"):
        write_set(path, measurements, outlined.experiment)
        with pytest.raises(InputError, match=message):
            Session.read(path, outlined.experiment)
    with pytest.raises(InputError, match=message):
        Measurement.read(tmp_path / "set" / "capsule-001.toml")
    with pytest.raises(InputError, match=message):
        Session(measurements, outlined.experiment)


def test_a_capsule_in_another_unit_among_others_is_left_out_by_name(outlined, tmp_path):
    measurements = [placed(outlined, PLACED["in um"][0])[0], *outlined.measurements[1:]]
    write_set(tmp_path / "set", measurements, outlined.experiment)
    session = Session.read(tmp_path / "set")
    assert len(session) == len(outlined) - 1
    assert "capsule-001.toml: outline: expected points over l" in session.left_out[0]


def test_points_on_a_line_are_no_outline():
    line = MeasuredOutline(np.stack([np.linspace(0.0, 2.0, 20), np.zeros(20)], axis=1), OutlineNoise(0.01, 0.2))
    with pytest.raises(InputError, match="points around an area"):
        check_placed(line, 2.0, "line.csv")


def test_capsules_without_a_shape_of_the_model_are_one_line(model):
    """Too long for any shape: there is nothing to compare."""
    session, _ = drawn_session(model, 12, seed=3)
    long = [replace(seen, axial_extent=1.9 * seen.axial_extent) for seen in session.measurements]
    with pytest.raises(
        NoShapeError, match=r"capsules some of which have a shape of square-neo-hookean, got 12 without"
    ):
        diagnose(Session(long, session.experiment), model, seed=1)


@pytest.mark.parametrize("command", ["diagnose", "batch", "membrane", "identify"])
def test_each_command_refuses_them_in_one_line(outlined, tmp_path, monkeypatch, capsys, command):
    place, _ = PLACED["flow to the left"]
    write_set(tmp_path / "set", placed(outlined, place), outlined.experiment)
    given = tmp_path / "set" / "capsule-001.toml" if command == "identify" else tmp_path / "set"
    out = ("--out", tmp_path / "made.nc") if command == "batch" else ()
    status, _, error = run(monkeypatch, capsys, command, given, *out)
    assert status == 2
    assert "capsule-001.toml: outline: expected the flow towards larger z" in error
    assert len(error.splitlines()) == 1
