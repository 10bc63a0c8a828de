"""Many capsules: every one a row, nothing lost by a kill, and the same digits whatever the order and the workers."""

import errno
import hashlib
import os
import signal
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from drawn import drawn
from polynomial_model import PolynomialModel
from processes import python, wait_until

from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment
from capsbayes.image import ByHand
from capsbayes.infer import Quadrature, identify
from capsbayes.infer.batch import CheckTask, Run, compared, cross_section_and_view, identify_folder
from capsbayes.infer.population import Population
from capsbayes.infer.posterior import REPORTED
from capsbayes.infer.prior import Prior
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.measurement_sets import MeasuredLengths, read_set, write_set
from capsbayes.quantity import Quantity
from capsbayes.run import Store
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate

batch = import_module("capsbayes.infer.batch")

MODEL = PolynomialModel()
EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.2e-6), viscosity=Quantity(0.85, 0.02))
PLACE = {"capillary_number": np.array([0.082]), "size_ratio": np.array([0.96])}
HERE = {"scheduler": "synchronous", "check": 0.0, "progress": False, "seed": 1}
SCRIPT = """
import sys
sys.path.insert(0, sys.argv[3])
from test_identify_folder import EXPERIMENT, MODEL
from capsbayes.infer import batch
from capsbayes.infer.batch import identify_folder
batch.ROWS = 3
identify_folder(sys.argv[1], MODEL, EXPERIMENT, out=sys.argv[2], seed=1, scheduler="synchronous", check=0.0)
"""


def write_table(path, count=12):
    rng = np.random.default_rng(5)
    theta = {"capillary_number": rng.uniform(0.04, 0.1, count), "size_ratio": rng.uniform(0.85, 1.0, count)}
    shape = MODEL(theta)
    frame = pd.DataFrame(
        {
            "name": [f"c{k}" for k in range(count)],
            "axial_extent_over_l": shape.axial_extent + 0.01 * rng.standard_normal(count),
            "axial_extent_error_over_l": 0.01,
            "axial_length_over_l": shape.axial_length - 0.02,
            "axial_length_error_over_l": 0.01,
            "capsule_velocity_mm_per_s": 5.0,
            "capsule_velocity_error_mm_per_s": 0.05,
        }
    )
    frame.to_csv(path, index=False)
    return frame


def batch_of(folder, source="t.csv", out="r.nc", model=MODEL, experiment=EXPERIMENT, **how):
    """Identify a table or a folder next to the output, or a frame."""
    given = folder / source if isinstance(source, str) else source
    return identify_folder(given, model, experiment, out=folder / out, **HERE | how)


@pytest.fixture
def folder(tmp_path):
    """A folder for measurements, with their experiment."""
    (tmp_path / "run").mkdir()
    EXPERIMENT.write(tmp_path / "run" / "experiment.toml")
    return tmp_path / "run"


def same(one, other):
    """Whether two populations have the same rows, to the last bit."""
    return all(np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f") for name in one.dataset)


def test_every_row_of_a_table_has_a_result_or_a_reason(tmp_path):
    frame = write_table(tmp_path / "t.csv").astype(object)
    frame.loc[1, "axial_extent_over_l"] = "n/k"
    frame.loc[2, "axial_extent_over_l"] = 9.0
    frame.loc[3, "capsule_velocity_error_mm_per_s"] = 4.0
    frame.loc[4, "axial_length_over_l"] = None
    frame["status"] = "DONE"
    frame.loc[5, "status"] = "DOUBLET"
    frame.to_csv(tmp_path / "t.csv", index=False)
    found = batch_of(tmp_path)
    status, reason = found["status"], found["reason"]
    assert len(found) == len(frame)
    assert (status[1], reason[1]) == ("UNUSABLE", "axial_extent_over_l: expected a number, got 'n/k'")
    assert status[2] == "NO_SHAPE"
    assert "standard errors away" in reason[2]
    assert found["distance"][0] < 3.0 < 5.0 < found["distance"][2]
    assert reason[3].startswith(
        "capsule_velocity_error: expected a standard error below 25% of the velocity, got 0.004"
    )
    assert status[5] == "DOUBLET"
    done = np.isin(np.arange(len(frame)), [1, 2, 3, 5], invert=True)
    assert np.isfinite(found["surface_shear_modulus_median"][done]).all()
    assert np.isnan(found["surface_shear_modulus_median"][~done]).all()
    assert found.counts[Status.UNUSABLE] == 2
    again = Population.read(tmp_path / "r.nc")
    assert same(found, again)
    header = (tmp_path / "r.csv").read_text().splitlines()[0]
    assert "surface_shear_modulus_median [N/m]" in header
    assert "capsule_radius_lower_95 [m]" in header


def test_a_frame_is_identified_like_its_file(tmp_path):
    frame = write_table(tmp_path / "t.csv", 4).astype(object)
    frame.loc[1, "axial_extent_over_l"] = 53.5
    found = batch_of(tmp_path, frame, "frame.nc")
    frame.to_csv(tmp_path / "t.csv", index=False)
    wanted = batch_of(tmp_path, "t.csv", "file.nc")
    assert found["reason"][1] == "axial_extent: expected a value from 0.01 to 20 l, got 53.5"
    assert set(found["source"]) == {"table"}
    for name in ("surface_shear_modulus_median", "status", "reason", "axial_extent", "name"):
        np.testing.assert_array_equal(found[name], wanted[name])
    assert not (tmp_path / "frame.nc.parts").exists()
    with pytest.raises(InputError, match="table: experiment: expected the experiment of the capsules"):
        batch_of(tmp_path, frame, experiment=None)


STATISTICS = ("mean", "sd", "median", "lower_68", "upper_68", "lower_95", "upper_95")


@pytest.mark.parametrize("name", ["square-neo-hookean", "circular-neo-hookean"])
def test_every_row_over_the_plane_is_that_of_identify(tmp_path, name):
    """Near borders too, with large errors, without L_a, with flow rates, own liquids and own priors."""
    model, rng, count = Surrogate.open(name), np.random.default_rng(8), 30
    own = replace(EXPERIMENT, cross_section=model.cross_section)
    (least, most), sizes = model.domain.bounds
    tried = {
        "capillary_number": np.exp(rng.uniform(np.log(least), np.log(most), 400)),
        "size_ratio": rng.uniform(*sizes, 400),
    }
    shape = model(tried)
    inside = np.flatnonzero(shape.inside)[:count]
    error = rng.choice([0.002, 0.01, 0.05], count)
    extent = shape.axial_extent[inside] + error * rng.standard_normal(count)
    length = np.minimum(shape.axial_length[inside] + error * rng.standard_normal(count), extent)
    number = np.arange(count)
    length[number % 4 == 0] = np.nan
    rate = np.where(number % 5 == 0, AREAS[own.cross_section] * 25e-6**2 * 5e-3 / shape.velocity_ratio[inside], np.nan)
    frame = pd.DataFrame(
        {
            "axial_extent_over_l": extent,
            "axial_extent_error_over_l": error,
            "axial_length_over_l": length,
            "axial_length_error_over_l": np.where(np.isnan(length), np.nan, error),
            "capsule_velocity_m_per_s": 5e-3,
            "capsule_velocity_error_m_per_s": rng.choice([2e-5, 5e-4], count),
            "flow_rate_m3_per_s": rate,
            "flow_rate_error_m3_per_s": 0.02 * rate,
            "viscosity_pa_s": np.where(number % 7 == 0, 1.2, np.nan),
            "surface_shear_modulus_prior": np.where(number % 11 == 1, "50 +/- 20 mN/m", ""),
        }
    )
    found = batch_of(tmp_path, frame, model=model, experiment=own)
    read = MeasuredLengths.of_frame(frame)
    identified = np.flatnonzero(np.isfinite(found["surface_shear_modulus_median"])).tolist()
    assert len(identified) > 0.8 * count
    for row in identified:
        seen, prior = read.measurement(row), Prior().with_texts(read.prior_texts(row))
        alone = replace(own, viscosity=Quantity(1.2, 1.2 * 0.02 / 0.85)) if row % 7 == 0 else own
        how = {"engine": "quadrature", "seed": 1, "prior": prior, "error_budget": False}
        wanted = identify(replace(seen, conditions={}), model, alone, **how)
        for quantity in ("surface_shear_modulus", "capsule_radius"):
            summary = wanted.marginals[quantity]
            for statistic in STATISTICS:
                off = found[f"{quantity}_{statistic}"][row] - getattr(summary, statistic)
                assert abs(off) < 1e-6 * summary.sd, (row, quantity, statistic)
        for measured, p_value in wanted.p_values.items():
            assert found[f"p_value_{measured}"][row] == pytest.approx(p_value, abs=1e-9)
        assert found["leaning_border"][row] == pytest.approx(wanted.leaning["model"], abs=0.05)
        leans = {found["status"][row], wanted.status.name} - {"DONE"}
        assert found["status"][row] == wanted.status.name or leans <= {"LEANS_ON_BORDER", "LEANS_ON_PRIOR"}


def test_the_likelihood_of_a_row_has_the_moments_of_the_posterior_under_flat_priors(tmp_path):
    """Of one capsule with both lengths, of one without L_a, whatever the prior of the run."""
    known = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
    flat = Prior(Quantity.log_uniform(1e-4, 10.0), Quantity.log_uniform(1e-6, 1e-3))
    frame = write_table(tmp_path / "t.csv", 2)
    frame.loc[1, ["axial_length_over_l", "axial_length_error_over_l"]] = np.nan
    uneven = Prior(Quantity.uniform(1e-3, 1.0), Quantity.uniform(1e-6, 1e-3))
    found = batch_of(tmp_path, frame, experiment=known, prior=uneven)
    for row, components in enumerate(found["likelihood"].astype(float)):
        posterior = Quadrature(MODEL, known, flat)(MeasuredLengths.of_frame(frame).measurement(row))
        draws = posterior.drawn(np.random.default_rng(2), 40_000)
        logs = np.log([draws["surface_shear_modulus"] / 0.85, draws["capsule_radius"] / 25e-6])
        weights, means = components[:, 0], components[:, 1:3]
        assert weights.sum() == pytest.approx(1.0, abs=1e-5)
        mean, away = weights @ means, means - weights @ means
        covariance = np.cov(logs)
        assert (np.abs(mean - logs.mean(axis=1)) < 0.02 * np.sqrt(covariance.diagonal())).all()
        for i, j, column in ((0, 0, 3), (0, 1, 4), (1, 1, 5)):
            of_mixture = weights @ (components[:, column] + away[:, i] * away[:, j])
            assert of_mixture == pytest.approx(covariance[i, j], rel=0.03)


def test_a_parquet_table_and_a_netcdf_of_lengths_are_tables_too(tmp_path):
    frame = write_table(tmp_path / "t.csv", 3)
    whole = batch_of(tmp_path, "t.csv", "a.nc")
    names = {name: name.removesuffix("_over_l").replace("_mm_per_s", "") for name in frame}
    scales = {name: 1e-3 if name.endswith("mm_per_s") else 1.0 for name in frame if name != "name"}
    columns = {names[name]: ("capsule", frame[name] * scale) for name, scale in scales.items()}
    xr.Dataset(columns).to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    found = batch_of(tmp_path, "t.nc", "b.nc")
    assert found["capsule_radius_median"] == pytest.approx(whole["capsule_radius_median"], rel=1e-9)
    pytest.importorskip("pyarrow")
    frame.to_parquet(tmp_path / "t.parquet")
    found = batch_of(tmp_path, "t.parquet", "c.nc")
    assert np.array_equal(found["capsule_radius_median"], whole["capsule_radius_median"])


@pytest.mark.slow
def test_order_of_the_rows_and_number_of_workers_change_no_digit(tmp_path, monkeypatch):
    frame = write_table(tmp_path / "t.csv")
    whole = batch_of(tmp_path, "t.csv", "a.nc")
    monkeypatch.setattr(batch, "ROWS", 5)
    assert same(whole, batch_of(tmp_path, out="b.nc", scheduler=None, workers=2))
    frame[::-1].to_csv(tmp_path / "u.csv", index=False)
    backward = batch_of(tmp_path, "u.csv", "c.nc")
    forward = backward.dataset.isel(capsule=slice(None, None, -1)).drop_vars(["source", "sha256"])
    assert same(Population(forward), Population(whole.dataset.drop_vars(["source", "sha256"])))


def test_a_killed_run_goes_on_where_it_was(tmp_path):
    write_table(tmp_path / "t.csv", 300)
    whole = batch_of(tmp_path, "t.csv", "whole.nc")
    out, parts = tmp_path / "r.nc", tmp_path / "r.nc.parts"
    with python("-c", SCRIPT, tmp_path / "t.csv", out, Path(__file__).parent) as run:
        wait_until(lambda: list(parts.glob("rows-*.part")), run)
        run.send_signal(signal.SIGKILL)
    kept = list(parts.glob("rows-*.part"))
    assert not out.exists()
    assert 0 < len(kept) < 100
    stamps = {file: file.stat().st_mtime_ns for file in kept}
    kept[0].write_bytes(kept[0].read_bytes()[:200])  # as a full disk or a power cut leaves a file
    computed = []
    save = Store.save

    def noted(store, name, values):
        computed.append(store.path(name))
        save(store, name, values)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(batch, "ROWS", 3)
        patched.setattr(Store, "save", noted)
        found = batch_of(tmp_path)
    assert same(found, whole)
    assert kept[0] in computed
    assert not any(file in computed for file in list(stamps)[1:])
    assert not parts.exists()


def test_a_slow_part_goes_on_at_the_row_where_it_was_stopped(tmp_path, monkeypatch):
    """Each row counts as many seconds, so that the rows are kept one by one."""
    seen = [Measurement(2.14 + 0.01 * k, 0.01, 5e-3, 5e-5, axial_length=1.81, axial_length_error=0.01) for k in (0, 1)]
    edge = MeasuredOutline(MODEL(PLACE, outline=True).outline[0], OutlineNoise(0.01, 0.2, 0.25))
    write_set(tmp_path / "o.nc", [replace(each, outline=edge) for each in (*seen, seen[0])], EXPERIMENT)
    whole = batch_of(tmp_path, "o.nc", "whole.nc")
    monkeypatch.setattr(batch, "_LONGEST_UNKEPT", -1.0)
    fill, filled = batch.fill_exactly, []

    def stopped(rows, row, *how):
        if len(filled) == 2:
            filled.append(None)
            raise KeyboardInterrupt
        filled.append(row)
        fill(rows, row, *how)

    monkeypatch.setattr(batch, "fill_exactly", stopped)
    with pytest.raises(KeyboardInterrupt) as interrupted:
        batch_of(tmp_path, "o.nc")
    assert interrupted.value.__notes__ == [f"finished work is kept in {tmp_path / 'r.nc.parts'}"]
    assert same(whole, batch_of(tmp_path, "o.nc"))
    assert filled == [0, 1, None, 2]


@pytest.mark.parametrize("edited", ["capsule", "experiment", "outline"])
def test_an_edited_file_of_the_same_size_and_time_is_computed_again(tmp_path, folder, edited):
    edge = MeasuredOutline(MODEL(PLACE, outline=True).outline[0], OutlineNoise(0.01, 0.2, 0.25))
    how = {"axial_length": 1.81, "axial_length_error": 0.01, "experiment_file": folder / "experiment.toml"}
    Measurement(2.14, 0.01, 5e-3, 5e-5, outline=edge, **how).write(folder / "capsule.toml")
    before = batch_of(tmp_path, "run", experiment=None)
    old, new = {"capsule": ("2.14", "2.16"), "experiment": ("0.85", "0.75"), "outline": ("1.", "1.0")}[edited]
    file = next(file for file in folder.iterdir() if edited in file.name)
    stamps, text = file.stat(), file.read_text()
    if edited == "outline":
        lines = text.splitlines(keepends=True)
        file.write_text("".join([*lines[:5], lines[5].replace(lines[5][-4:-1], "777"), *lines[6:]]))
    else:
        assert old in text
        file.write_text(text.replace(old, new))
    os.utime(file, ns=(stamps.st_atime_ns, stamps.st_mtime_ns))
    assert file.stat().st_size == stamps.st_size
    assert file.stat().st_mtime_ns == stamps.st_mtime_ns
    after = batch_of(tmp_path, "run", experiment=None)
    assert before["surface_shear_modulus_median"] != after["surface_shear_modulus_median"]


def test_rows_that_stay_are_kept_when_a_table_is_edited_and_name_the_table_as_it_is(tmp_path, monkeypatch):
    frame = write_table(tmp_path / "t.csv", 6)
    monkeypatch.setattr(batch, "ROWS", 3)
    with monkeypatch.context() as patched:
        patched.setattr(Population, "write", lambda self, path: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            batch_of(tmp_path)
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "r.nc.parts").glob("rows-*.part")}
    frame.loc[5, "axial_extent_over_l"] += 0.01
    frame.loc[5, "name"] = "a much longer name"
    frame.to_csv(tmp_path / "t.csv", index=False)
    removed = []
    monkeypatch.setattr(batch.shutil, "rmtree", removed.append)
    found = batch_of(tmp_path)
    assert removed == [tmp_path / "r.nc.parts"]
    assert all(file.stat().st_mtime_ns == stamp for file, stamp in stamps.items())
    assert len(list((tmp_path / "r.nc.parts").glob("rows-*.part"))) == 3
    assert set(found["sha256"]) == {hashlib.sha256((tmp_path / "t.csv").read_bytes()).hexdigest()}


@pytest.mark.parametrize("changed", ["viscosity", "coordinate", "velocity"])
def test_every_digit_of_the_settings_counts(changed):
    run = Run(MODEL, EXPERIMENT, Prior(), 1, Quantity(5e-3, 5e-5, "m/s"))
    other = {
        "viscosity": replace(run, experiment=replace(EXPERIMENT, viscosity=Quantity(0.85, 0.02 + 1e-12))),
        "coordinate": replace(run, prior=Prior(coordinates={"pre_inflation": "0 .. 0.1"})),
        "velocity": replace(run, capsule_velocity=Quantity(5e-3 + 1e-15, 5e-5, "m/s")),
    }
    assert run.fingerprint == replace(run).fingerprint != other[changed].fingerprint


def test_a_full_disk_is_said_and_loses_nothing(tmp_path, monkeypatch):
    write_table(tmp_path / "t.csv", 6)
    monkeypatch.setattr(batch, "ROWS", 3)
    save, written = Store.save, []

    def full(store, name, values):
        if written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(store.path(name))
        save(store, name, values)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Store, "save", full)
        with pytest.raises(InputError, match=r"room on the disk.*start again: what is finished is kept"):
            batch_of(tmp_path)
    assert written[0].exists()
    assert len(batch_of(tmp_path)) == 6


def test_tasks_of_killed_workers_are_tried_again(tmp_path, monkeypatch):
    write_table(tmp_path / "t.csv", 2)
    attempts = []

    def killed(tasks, scheduler, workers, run):
        attempts.append(len(tasks))
        raise BrokenProcessPool("a process in the pool was terminated abruptly")

    once = batch.run_tasks
    monkeypatch.setattr(batch, "run_tasks", lambda *how: once(*how) if attempts else killed(*how))
    assert len(batch_of(tmp_path)) == 2
    monkeypatch.setattr(batch, "run_tasks", killed)
    attempts.clear()
    with pytest.raises(InputError, match=r"one killed at each attempt; give it more memory"):
        batch_of(tmp_path, "t.csv", "s.nc")
    assert attempts == [1, 1, 1]


@pytest.mark.slow
def test_pictures_are_measured_and_identified(tmp_path, folder):
    made = drawn(0.06, 0.9)
    cv2.imwrite(str(folder / "a.png"), made.picture)
    cv2.imwrite(str(folder / "empty.png"), made.background)
    model = Surrogate.open("square-neo-hookean", view="silhouette")
    found = batch_of(tmp_path, "run", model=model, shared_velocity=Quantity(5e-3, 5e-5, "m/s"))
    assert found["name"].tolist() == ["a", "empty"]
    assert Status[found["status"][0]].ok
    assert found["status"][1] in ("NO_WALLS", "NO_CAPSULE")
    assert found["surface_shear_modulus_median"][0] > 0.0
    assert cross_section_and_view(folder, EXPERIMENT) == ("square", "silhouette")
    bare = batch_of(tmp_path, "run", "s.nc", model=model)
    assert "capsule_velocity: expected what a picture does not show" in bare["reason"][0]


def test_walls_that_are_stated_hold_for_all_pictures_of_a_folder(tmp_path):
    made = drawn(0.06, 0.9, half_width=55.0)
    cv2.imwrite(str(tmp_path / "a.png"), made.picture)
    speed = Quantity(5e-3, 5e-5, "m/s")
    run = Run(MODEL, EXPERIMENT, Prior(), 1, speed)
    stated = replace(run, by_hand=ByHand(walls="44.5, 154.5"))
    measured = batch.measured_file(tmp_path / "a.png", stated)
    assert measured.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 1 px"
    assert measured.axial_extent == pytest.approx(made.axial_extent / 55.0, rel=0.02)
    assert batch.measured_file(tmp_path / "a.png", run).walls == ""
    assert stated.fingerprint != run.fingerprint


@pytest.mark.parametrize("name", ["day.avi", "day.rtdc", "day.tif"])
def test_a_film_among_the_files_of_a_folder_is_measured_first(tmp_path, name):
    """In one line that says how; what was measured in the folder of its name is then read, and the film is not."""
    folder = tmp_path / "films"
    folder.mkdir()
    if name == "day.tif":
        cv2.imwritemulti(str(folder / name), [np.full((64, 64), 90, dtype=np.uint8)] * 3)
    else:
        (folder / name).write_bytes(b"RIFF")
    for read in (batch.capsule_files, read_set):
        with pytest.raises(
            InputError, match=r"its capsules measured before, in the folder .*day, got none; run"
        ) as error:
            read(folder)
        assert f"capsbayes measure {folder / name} --experiment EXPERIMENT --out {folder / 'day'}" in str(error.value)
    EXPERIMENT.write(tmp_path / "experiment.toml")
    seen = Measurement(2.14, 0.01, 5e-3, 5e-5, experiment_file=tmp_path / "experiment.toml")
    (folder / "day" / "capsule-1").mkdir(parents=True)
    seen.write(folder / "day" / "capsule-1" / "measurement.toml")
    (folder / "day" / ("events.csv" if name.endswith("rtdc") else "capsules.csv")).write_text("capsule\n")
    assert batch.capsule_files(folder) == [folder / "day" / "capsule-1" / "measurement.toml"]
    assert len(read_set(folder).measurements) == 1


def test_capsules_of_several_films_are_named_by_film_and_capsule(tmp_path):
    EXPERIMENT.write(tmp_path / "experiment.toml")
    for film in ("first", "second"):
        place = tmp_path / "films" / film / "capsule-1"
        place.mkdir(parents=True)
        seen = Measurement(2.14, 0.01, 5e-3, 5e-5, experiment_file=tmp_path / "experiment.toml")
        seen.write(place / "measurement.toml")
    rows = batch_of(tmp_path, "films", experiment=None)
    assert rows["name"].tolist() == ["first/capsule-1", "second/capsule-1"]
    alone = batch_of(tmp_path, "films/first", "one.nc", experiment=None)
    assert alone["name"].tolist() == ["capsule-1"]


def test_a_folder_goes_on_with_new_files_and_refuses_the_damaged_by_name(tmp_path, folder):
    named = {"experiment_file": folder / "experiment.toml"}
    for k in range(3):
        one = Measurement(2.14 + 0.01 * k, 0.01, 5e-3, 5e-5, axial_length=1.81, axial_length_error=0.01, **named)
        one.write(folder / f"capsule-{k}.toml")
    (folder / "torn.toml").write_text("[measurement]\naxial_extent =")
    first = batch_of(tmp_path, "run", experiment=None)
    assert first["status"].tolist() == ["DONE"] * 3 + ["UNUSABLE"]
    assert "torn.toml: expected a TOML file" in first["reason"][3]
    assert len(first["sha256"][0]) == 64
    kept = {file: file.stat().st_mtime_ns for file in (tmp_path / "r.nc.parts").glob("file-*.part")}
    Measurement(2.2, 0.01, 5e-3, 5e-5, **named).write(folder / "capsule-9.toml")
    second = batch_of(tmp_path, "run", experiment=None)
    assert second["name"].tolist() == ["capsule-0", "capsule-1", "capsule-2", "capsule-9", "torn"]
    assert all(file.stat().st_mtime_ns == stamp for file, stamp in kept.items())


def test_a_change_of_the_experiment_that_files_name_is_a_change_of_their_rows(tmp_path, folder):
    twice = Experiment(cross_section="square", half_width=25e-6, viscosity=1.7)
    how = {"axial_length": 1.81, "axial_length_error": 0.01}
    for name in "ab":
        Measurement(2.14, 0.01, 5e-3, 5e-5, **how, experiment_file=folder / "experiment.toml").write(
            folder / f"{name}.toml"
        )
    first = batch_of(tmp_path, "run", experiment=None)
    assert first.attributes["experiment"]["viscosity"]["value"] == pytest.approx(0.85)
    twice.write(folder / "experiment.toml")
    second = batch_of(tmp_path, "run", experiment=None)
    both = [one["surface_shear_modulus_median"] for one in (first, second)]
    assert both[1] == pytest.approx(2.0 * both[0], rel=0.01)
    # under two experiments there is none for all, and each counts for its own capsule
    EXPERIMENT.write(folder / "other.toml")
    Measurement(2.14, 0.01, 5e-3, 5e-5, **how, experiment_file=folder / "other.toml").write(folder / "b.toml")
    third = batch_of(tmp_path, "run", experiment=None)
    assert third.attributes["experiment"] == {}
    assert third["surface_shear_modulus_median"] == pytest.approx([both[1][0], both[0][1]], rel=0.01)
    EXPERIMENT.write(folder / "experiment.toml")
    fourth = batch_of(tmp_path, "run", experiment=None)
    assert fourth["surface_shear_modulus_median"] == pytest.approx(both[0], rel=0.01)


def test_lengths_in_metres_and_outlines_are_rows_too(tmp_path, folder):
    extent, length, error = 2.14 * 25e-6, 1.81 * 25e-6, 0.01 * 25e-6
    metres = Measurement(
        extent, error, 5e-3, 5e-5, axial_length=length, axial_length_error=error, over_half_width=False
    )
    metres.write(folder / "a.toml")
    theta = {"capillary_number": np.array([0.082]), "size_ratio": np.array([0.96])}
    points = MODEL(theta, outline=True).outline[0]
    edge = MeasuredOutline(points, OutlineNoise(0.01, 0.2, 0.25))
    Measurement(2.14, 0.01, 5e-3, 5e-5, axial_length=1.81, axial_length_error=0.01, outline=edge).write(
        folder / "b.toml"
    )
    found = batch_of(tmp_path, "run", "r.nc")
    assert found["engine"].tolist() == ["grid", "grid"]
    assert found["capillary_number_median"] == pytest.approx(0.082, rel=0.1)
    weights = found["likelihood"][:, :, 0]
    assert weights.sum(axis=1) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.slow
def test_some_capsules_are_sampled_and_agree_and_chains_are_kept_on_request(tmp_path):
    write_table(tmp_path / "t.csv", 4)
    found = batch_of(tmp_path, chains=tmp_path / "chains", check=0.5)
    agreement = found.attributes["agreement"]
    assert agreement["capsules"] == agreement["agreeing"] == 2
    assert max(agreement[name] for name in ("median", "ends_68", "ends_95")) < 0.1
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "chains").glob("*.nc")}
    assert len(stamps) == 4
    frame = write_table(tmp_path / "t.csv", 4)
    frame.loc[3, "axial_extent_over_l"] += 0.01
    frame.to_csv(tmp_path / "t.csv", index=False)
    batch_of(tmp_path, chains=tmp_path / "chains")
    assert [file.name for file, stamp in stamps.items() if file.stat().st_mtime_ns != stamp] == ["000004-c3.nc"]


def test_a_check_compares_the_ends_with_emcee_and_can_fail(tmp_path):
    frame = write_table(tmp_path / "t.csv", 1)
    rows = batch_of(tmp_path, frame, "r.nc")
    names = [f"{name}_{statistic}" for name in REPORTED for statistic in STATISTICS]
    right = np.array([rows[name][0] for name in names]).reshape(len(REPORTED), -1)
    wrong, wider = right.copy(), right.copy()
    wrong[0, 6] -= 0.3 * wrong[0, 1]  # the upper end of the 95 % interval of G_s
    wider[0, 6] += 0.3 * wrong[0, 1]
    run, seen = Run(MODEL, EXPERIMENT, Prior(), 1), MeasuredLengths.of_frame(frame).measurement(0)
    words = []
    for number, summaries in enumerate((right, wrong, wider)):
        task = CheckTask(Store(tmp_path / str(number), "x"), seen, summaries, 1, Prior())
        task(run)
        assert np.abs(task.differences).max() > 0.0
        words.append(str(compared([task.differences])))
    assert words[0].startswith("1 of 1 capsules drawn at random and sampled with emcee agree within 0.1 sd")
    assert words[1].startswith("0 of 1 capsules")
    assert "of those that do not, 0 of 1 have the wider intervals" in words[1]
    assert "of those that do not, 1 of 1 have the wider intervals" in words[2]


@pytest.mark.parametrize(
    ("source", "how", "words"),
    [
        ("nothing", {}, "nothing there"),
        ("t.ods", {}, "ends in .ods"),
        ("empty.csv", {}, "expected"),
        ("torn.nc", {}, "a NetCDF file"),
        ("folder", {}, "a folder without any"),
        ("t.csv", {"experiment": None}, "--experiment"),
        ("t.csv", {"background": "empty.png"}, r"empty\.png: expected a picture of the empty channel"),
        (
            "t.csv",
            {"prior": Prior(coordinates={"pre_inflaton": "0 .. 0.1"})},
            "prior: pre_inflaton: expected a coordinate",
        ),
    ],
)
def test_what_cannot_be_used_is_one_clear_line(tmp_path, source, how, words):
    write_table(tmp_path / "t.csv", 2)
    (tmp_path / "folder").mkdir()
    for name in ("t.ods", "empty.csv", "torn.nc"):
        (tmp_path / name).write_text("")
    with pytest.raises(InputError, match=words) as caught:
        batch_of(tmp_path, source, **how)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "r.nc.parts").exists()


def test_the_folder_of_the_result_is_made(tmp_path):
    write_table(tmp_path / "batch.csv", 3)
    batch_of(tmp_path, "batch.csv", "new/run.nc")
    assert sorted(file.name for file in (tmp_path / "new").iterdir() if file.suffix) == [
        ".capsbayes.sha256",
        "run.csv",
        "run.nc",
    ]


def test_an_error_of_the_program_is_not_taken_for_one_of_the_disk(tmp_path, monkeypatch):
    def broken(*arguments):
        raise np.linalg.LinAlgError("Singular matrix")

    write_table(tmp_path / "batch.csv", 3)
    monkeypatch.setattr(batch, "listed", broken)
    with pytest.raises(np.linalg.LinAlgError, match="Singular"):
        batch_of(tmp_path, "batch.csv", "run.nc")
