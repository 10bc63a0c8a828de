"""What is written is read back in each of the three forms; what cannot be used is left out and said."""

import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import stats
from sessions import EXPERIMENT

from capsbayes.diagnosis.session import Session
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.batch import capsule_files
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise, Pose
from capsbayes.measurement_sets import measurement_files
from capsbayes.quantity import Quantity

NUMBERS = (
    *("axial_extent", "axial_extent_error", "capsule_velocity", "capsule_velocity_error"),
    *("axial_length", "flow_rate"),
)


def capsule(number, *, outline=False, **how):
    angle = np.linspace(0.0, 2.0 * np.pi, 20 + number, endpoint=False)
    edge = MeasuredOutline(np.stack([np.cos(angle), np.sin(angle)], axis=1), OutlineNoise(0.01, 0.2, 0.25))
    lengths = {"axial_length": 1.8 + 0.01 * number, "axial_length_error": 0.02, "flow_rate": 1e-11 * (1 + number)} | how
    return Measurement(2.1, 0.01, np.float64(5e-3), 5e-5, **lengths, outline=edge if outline else None)


def session(count=3, *, outline=False):
    return Session([capsule(number, outline=outline) for number in range(count)], EXPERIMENT)


def assert_same(found, wanted):
    assert len(found) == len(wanted)
    for name in NUMBERS:
        given = [getattr(one, name) for one in wanted.measurements]
        assert [getattr(one, name) for one in found.measurements] == given, name
    for one, other in zip(found.measurements, wanted.measurements, strict=True):
        assert (one.outline is None) == (other.outline is None)
        if one.outline is not None:
            np.testing.assert_allclose(one.outline.points, other.outline.points, atol=1e-8)
            assert (one.outline.noise, one.outline.pose) == (other.outline.noise, other.outline.pose)


@pytest.mark.parametrize("outline", [False, True])
def test_a_folder_is_read_back_with_its_experiment(tmp_path, outline):
    wanted = session(outline=outline)
    wanted.write(tmp_path / "set")
    (tmp_path / "set").rename(tmp_path / "moved")
    found = Session.read(tmp_path / "moved")
    assert_same(found, wanted)
    assert found.left_out == ()
    for name in ("half_width", "viscosity"):
        assert getattr(found.experiment, name) == getattr(EXPERIMENT, name)
    assert found.experiment.cross_section == "square"


@pytest.mark.parametrize("name", ["set.csv", "set.nc"])
def test_a_file_is_read_back_with_the_conditions_of_each_capsule(tmp_path, name):
    own, outline = {"conditions": {"viscosity": 0.7}}, name.endswith(".nc")
    each = [capsule(0, outline=outline), capsule(1, outline=outline, **own), capsule(2, outline=outline, **own)]
    if not outline:
        each.append(capsule(9, axial_length=None, axial_length_error=None, flow_rate=None))
    wanted = Session(each, EXPERIMENT)
    wanted.write(tmp_path / name)
    EXPERIMENT.write(tmp_path / "channel.toml")
    for experiment in (EXPERIMENT, tmp_path / "channel.toml"):
        found = Session.read(tmp_path / name, experiment)
        assert_same(found, wanted)
        assert [dict(one.conditions) for one in found.measurements[:3]] == [{}, *2 * [{"viscosity": 0.7}]]
    with pytest.raises(InputError, match=r"expected capsules under one experiment.*write a \.csv or a \.nc"):
        wanted.write(tmp_path / "folder")
    assert not (tmp_path / "folder").exists()


def test_a_file_of_outlines_may_name_its_experiment(tmp_path):
    session(outline=True).write(tmp_path / "set.nc")
    EXPERIMENT.write(tmp_path / "channel.toml")
    with xr.open_dataset(tmp_path / "set.nc", engine="h5netcdf") as opened:
        dataset = opened.load().assign_attrs(experiment="channel.toml")
    dataset["name"] = ("capsule", ["a", "b", "c"])
    dataset.to_netcdf(tmp_path / "named.nc", engine="h5netcdf")
    found = Session.read(tmp_path / "named.nc")
    assert found.mean("half_width") == 25e-6
    assert found.measurements[1].source.endswith("named.nc: capsule b")


def test_the_folder_and_the_table_of_a_film_are_sets(tmp_path):
    EXPERIMENT.write(tmp_path / "channel.toml")
    for number in (1, 2):
        (tmp_path / f"capsule-{number}").mkdir()
        seen = replace(capsule(number), experiment_file=tmp_path / "channel.toml")
        seen.write(tmp_path / f"capsule-{number}" / "measurement.toml")
    assert len(Session.read(tmp_path)) == 2
    (tmp_path / "capsules.csv").write_text(
        "capsule,status,frames,alike,axial_extent_over_l,axial_extent_error_over_l,axial_length_over_l,"
        "axial_length_error_over_l,velocity_m_s,velocity_error_m_s\n"
        "1,DONE,8,7,2.1,0.01,1.8,0.01,0.005,0.00005\n2,DOUBLET,8,8,nan,nan,,,nan,nan\n"
    )
    found = Session.read(tmp_path / "capsules.csv", EXPERIMENT)
    assert len(found) == 1
    (line,) = found.left_out
    assert "capsules.csv: capsule 2: status: expected DONE, got The outline is notched" in line


def test_folders_of_several_films_are_one_set(tmp_path):
    """Each film, and each .rtdc file, left a folder with one for each of its capsules."""
    EXPERIMENT.write(tmp_path / "channel.toml")
    written = []
    for number, place in enumerate(("film-1/capsule-1", "film-1/capsule-2", "film-2/capsule-1", "cells/event-7")):
        (tmp_path / place).mkdir(parents=True)
        written.append(replace(capsule(number), experiment_file=tmp_path / "channel.toml"))
        written[-1].write(tmp_path / place / "measurement.toml")
    folders = [path.parent.name for path in measurement_files(tmp_path)]
    assert folders == ["event-7", "capsule-1", "capsule-2", "capsule-1"]
    assert capsule_files(tmp_path) == measurement_files(tmp_path)
    found = Session.read(tmp_path).measurements
    assert sorted(one.axial_extent for one in found) == sorted(one.axial_extent for one in written)


def test_velocities_may_be_in_millimetres_and_flow_rates_in_microlitres(tmp_path):
    path = tmp_path / "set.csv"
    path.write_text(
        "name, axial_extent_over_l, axial_extent_error_over_l, capsule_velocity_mm_per_s, "
        "capsule_velocity_error_mm_per_s, flow_rate_ul_per_min\nA, 2.1, 0.01, 5.0, 0.05, 0.6\n"
    )
    (one,) = Session.read(path, EXPERIMENT).measurements
    assert (one.capsule_velocity, one.capsule_velocity_error) == pytest.approx((5e-3, 5e-5))
    assert one.flow_rate == pytest.approx(1e-11)
    assert one.source == f"{path}: capsule A"


def test_capsules_that_cannot_be_used_are_left_out_and_said(tmp_path):
    folder = tmp_path / "set"
    session(4).write(folder)
    first, second, third = (folder / f"capsule-00{number}.toml" for number in (1, 2, 3))
    first.write_text(first.read_text().replace("2.1 +/- 0.01", "2.1"))
    second.write_text("no toml")
    third.write_text(re.sub(r'(axial_\w+ = "[^"]+)"', r'\1 um"', third.read_text()))
    found = Session.read(folder)
    assert len(found) == 1
    assert ["a standard error" in found.left_out[0], "a TOML file" in found.left_out[1]] == [True, True]
    assert "capsule-003.toml: axial_extent: expected lengths over l, got lengths in metres" in found.left_out[2]
    assert not any("\n" in line for line in found.left_out)


def named_by_the_second(folder, experiment):
    """A set whose second capsule names another experiment."""
    session().write(folder)
    experiment.write(folder / "other.toml")
    second = folder / "capsule-002.toml"
    second.write_text(second.read_text().replace("experiment.toml", "other.toml"))
    return second


def test_each_capsule_of_a_folder_may_name_its_own_experiment(tmp_path):
    folder = tmp_path / "set"
    second = named_by_the_second(folder, replace(EXPERIMENT, viscosity=0.5, half_width=30e-6))
    found = Session.read(folder)
    usual = EXPERIMENT.viscosity.mean
    np.testing.assert_allclose(found.circumstances["viscosity"], [usual, 0.5, usual])
    np.testing.assert_allclose(found.circumstances["half_width"], [25e-6, 30e-6, 25e-6], rtol=1e-6)
    assert Session.read(folder, folder / "other.toml").mean("viscosity") == 0.5
    second.write_text(second.read_text().replace('experiment = "other.toml"', ""))
    with pytest.raises(InputError, match=r"capsule-002.toml: experiment: expected the name of a file, got nothing"):
        Session.read(folder)


def test_capsules_of_different_cross_sections_are_no_set(tmp_path):
    named_by_the_second(tmp_path / "set", replace(EXPERIMENT, cross_section="circular"))
    with pytest.raises(InputError, match=r"other.toml: cross_section: expected 'square' as in .*experiment.toml"):
        Session.read(tmp_path / "set")


def test_conditions_may_be_in_micrometres_and_are_checked(tmp_path):
    path = tmp_path / "set.csv"
    header, row = TABLE.splitlines()
    path.write_text(f"{header},half_width_um,viscosity_mpa_s\n{row},27.5,\n{row},0,800\n")
    found = Session.read(path, EXPERIMENT)
    assert found.circumstances["half_width"] == pytest.approx([27.5e-6])
    assert "capsule 2: half_width: expected a positive finite number, got " in found.left_out[0]


TABLE = (
    "axial_extent_over_l,axial_extent_error_over_l,capsule_velocity_m_per_s,capsule_velocity_error_m_per_s\n"
    "2.1,0.01,0.005,0.00005\n"
)
WITHOUT_EXTENT = TABLE.replace("axial_extent_over_l,", "").replace("2.1,", "")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("axial_extent_over_l", "axial_extent_um"),
            "set.csv: axial_extent_um: expected a column of a table of lengths",
        ),
        ((TABLE, WITHOUT_EXTENT), "set.csv: axial_extent_over_l: expected a column of this name, got only"),
        (("2.1,", "long,"), "capsule 1: axial_extent_over_l: expected a number, got 'long'"),
        (("2.1,", "-2.1,"), "capsule 1: axial_extent: expected a positive finite number, got -2.1"),
        (("2.1,0.01,0.005,0.00005\n", ""), "set.csv: expected at least one capsule, got none"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path, change, message):
    path = tmp_path / "set.csv"
    path.write_text(TABLE.replace(*change))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        Session.read(path, EXPERIMENT)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda one: one.drop_vars("noise_scale"), "set.nc: noise_scale: expected a variable (capsule) in l, got noth"),
        (lambda one: one.rename(point="place"), "set.nc: outline: expected a variable (capsule, point, axis) in l"),
        (
            lambda one: one.assign(capsule_velocity=one.capsule_velocity.assign_attrs(units="mm/s")),
            "set.nc: capsule_velocity: expected a variable (capsule) in m/s, got one in mm/s; convert it",
        ),
        (lambda one: one.assign(noise_scale=-one.noise_scale), "set.nc: capsule 1: scale: expected a positive number"),
    ],
)
def test_a_wrong_file_of_outlines_is_one_line(tmp_path, change, message):
    session(outline=True).write(tmp_path / "made.nc")
    with xr.open_dataset(tmp_path / "made.nc", engine="h5netcdf") as opened:
        change(opened.load()).to_netcdf(tmp_path / "set.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=re.escape(message)):
        Session.read(tmp_path / "set.nc", EXPERIMENT)


def test_what_is_no_set_is_said(tmp_path):
    with pytest.raises(
        InputError, match=r"expected a folder of measurement files, a \.csv or .* a \.nc file, got noth"
    ):
        Session.read(tmp_path / "missing")
    (tmp_path / "one.toml").write_text("")
    with pytest.raises(InputError, match="put the measurement files into one folder"):
        Session.read(tmp_path / "one.toml")
    (tmp_path / "damaged.nc").write_text("no file")
    with pytest.raises(InputError, match="expected a NetCDF file"):
        Session.read(tmp_path / "damaged.nc")
    (tmp_path / "set.csv").write_text(TABLE)
    with pytest.raises(InputError, match="expected the experiment of the capsules, got nothing; say which"):
        Session.read(tmp_path / "set.csv")


def test_a_form_without_place_for_what_there_is_refuses_it(tmp_path):
    with pytest.raises(InputError, match="expected capsules without outlines, got one with"):
        session(outline=True).write(tmp_path / "set.csv")
    with pytest.raises(InputError, match="expected capsules with outlines, got one without"):
        session().write(tmp_path / "set.nc")
    session().write(tmp_path / "set")
    with pytest.raises(InputError, match="expected a folder without TOML files"):
        session().write(tmp_path / "set")


def test_the_pose_of_an_outline_is_kept_or_refused(tmp_path):
    one = capsule(1, outline=True)
    posed = replace(one, outline=replace(one.outline, pose=Pose(offset=0.01)))
    wanted = Session([posed], EXPERIMENT)
    wanted.write(tmp_path / "set")
    assert_same(Session.read(tmp_path / "set"), wanted)
    with pytest.raises(InputError, match=r"set.nc: outline.pose: expected outlines of the usual pose"):
        wanted.write(tmp_path / "set.nc")
    file = tmp_path / "set" / "capsule-001.toml"
    written = file.read_text()
    for change, message in (
        (("offset =", "halo ="), "outline.pose.halo: expected one of along, across, tilt, offset"),
        (("offset = 0.01", "offset = -0.01"), "outline.pose.offset: expected a number from 0 to 1000, got -0.01"),
    ):
        file.write_text(written.replace(*change))
        with pytest.raises(InputError, match=re.escape(message)):
            Session.read(tmp_path / "set")


def test_a_file_of_outlines_keeps_and_holds_one_view(tmp_path):
    mid_plane, *others = session(outline=True).measurements
    silhouettes = [replace(each, outline=replace(each.outline, view="silhouette")) for each in others]
    Session(silhouettes, EXPERIMENT).write(tmp_path / "set.nc")
    again = Session.read(tmp_path / "set.nc", EXPERIMENT)
    assert {each.outline.view for each in again.measurements} == {"silhouette"}
    with pytest.raises(InputError, match=r"outline\.view: expected outlines of one view, got mid-plane, silhouette"):
        Session([mid_plane, *silhouettes], EXPERIMENT).write(tmp_path / "set.nc")


def test_an_experiment_is_read_back(tmp_path):
    known = Experiment(cross_section="circular", half_width=30e-6, viscosity=EXPERIMENT.viscosity)
    known.write(tmp_path / "experiment.toml")
    found = Experiment.read(tmp_path / "experiment.toml")
    assert (found.cross_section, found.half_width) == ("circular", Quantity(30e-6, unit="m"))
    assert found.viscosity == EXPERIMENT.viscosity
    with pytest.raises(InputError, match=r"viscosity: expected a number, .*, got a distribution of the kind gamma"):
        replace(known, viscosity=stats.gamma(4.0)).write(tmp_path / "experiment.toml")
