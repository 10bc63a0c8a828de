"""What a posterior tells, and its file: it comes back whole, and what is no such file is said in one line."""

import json
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import scipy.stats
import xarray as xr

from capsbayes import Posterior
from capsbayes.errors import InputError
from capsbayes.infer import identify
from capsbayes.infer.checks import Agreement, Gate
from capsbayes.infer.posterior import RECORD, REPORTED, DeterministicAnswer
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.measurement import SILHOUETTE, MeasuredOutline, OutlineNoise, Pose
from capsbayes.quantity import Quantity
from capsbayes.status import Status


@pytest.fixture(scope="module")
def posterior(model, experiment, capsule):
    return identify(capsule, model, experiment, engine="quadrature", seed=4)


def again(posterior, folder):
    return Posterior.read(posterior.write(folder / "posterior.nc"))


def check_same(one, other):
    assert one.as_dict() == other.as_dict()
    for name in ("marginals", "reference", "deterministic", "agreement", "gates", "version", "status"):
        assert getattr(one, name) == getattr(other, name), name
    assert set(one.draws) == set(other.draws)
    for name, values in one.draws.items():
        np.testing.assert_array_equal(other.draws[name], values)
    np.testing.assert_array_equal(one.ensemble, other.ensemble)
    np.testing.assert_array_equal(one.outlines, other.outlines)


def test_a_posterior_comes_back_whole(posterior, tmp_path):
    found = again(posterior, tmp_path)
    check_same(posterior, found)
    assert found.measurement.outline is None
    for name in ("viscosity", "half_width", "capsule_velocity"):
        assert getattr(posterior.inputs, name) == getattr(found.inputs, name)
    check_same(found, again(found, tmp_path))


def test_everything_that_may_be_missing_comes_back_too(posterior, tmp_path):
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    points = np.stack([np.cos(angle), 0.8 * np.sin(angle)], axis=1)
    outline = MeasuredOutline(points, OutlineNoise(0.01, 0.3, 0.2), Pose(offset=0.004), SILHOUETTE)
    measurement = replace(
        posterior.measurement,
        outline=outline,
        axial_length=None,
        axial_length_error=None,
        axial_length_bound=2.2,
        flow_rate=1e-11,
        source="folder/capsule.png",
        sha256="12",
        experiment_file=Path("channel.toml"),
        conditions={"viscosity": 0.9},
    )
    experiment = replace(
        posterior.experiment, viscosity=scipy.stats.gamma(400.0, scale=0.002), frame_rate=Quantity(2e3, 1.0, "1/s")
    )
    whole = replace(
        posterior,
        measurement=measurement,
        experiment=experiment,
        inputs=Inputs.of(measurement, experiment),
        prior=Prior(Quantity.uniform(1e-3, 1.0), coordinates={"pre_inflation": scipy.stats.norm(0.03, 0.01)}),
        draws=posterior.draws | {"lp": posterior.draws["size_ratio"] - 1.0},
        reference=posterior.marginals,
        gates=(Gate("cells", 5.0, least=4.0), Gate("stuck", float("nan"), most=0.0)),
        agreement=Agreement(0.02, 0.3, 0.1, "size_ratio", passed=False),
        deterministic=DeterministicAnswer(0.04, 24e-6, 4e-3, 0.08, 0.96, 1.3, {"pre_inflation": 0.0}),
        outlines=None,
        status=Status.ENGINES_DISAGREE,
        version="0.0.7",
    )
    found = again(whole, tmp_path)
    for name in ("reference", "agreement", "deterministic", "status", "version", "outlines", "shares", "leaning"):
        assert getattr(found, name) == getattr(whole, name), name
    assert repr(found.gates) == repr(whole.gates)
    np.testing.assert_array_equal(found.draws["lp"], whole.draws["lp"])
    np.testing.assert_array_equal(found.measurement.outline.points, outline.points)
    assert (found.measurement.outline.noise, found.measurement.outline.pose) == (outline.noise, outline.pose)
    assert found.measurement.outline.view == SILHOUETTE
    for name in ("source", "experiment_file", "axial_length", "axial_length_bound", "flow_rate", "conditions"):
        assert getattr(found.measurement, name) == getattr(measurement, name)
    assert found.experiment.frame_rate == experiment.frame_rate
    assert found.experiment.viscosity.ppf(0.3) == experiment.viscosity.ppf(0.3)
    assert found.prior.surface_shear_modulus == whole.prior.surface_shear_modulus
    assert found.prior.coordinates["pre_inflation"].ppf(0.9) == whole.prior.coordinates["pre_inflation"].ppf(0.9)
    assert found.inputs.viscosity == whole.inputs.viscosity


def test_a_file_of_the_first_version_is_still_read():
    """It was written by 0.1.0, with an outline, a prior of a coordinate and a viscosity that is gamma distributed."""
    folder = Path(__file__).parent / "data"
    found = Posterior.read(folder / "posterior-0.1.0.nc")
    written = json.loads((folder / "posterior-0.1.0.json").read_text())
    assert written["prior"]["pre_inflation"].pop("distribution") == "norm"  # the name in scipy, now "normal"
    written["inputs"]["cross_section"] = written["inputs"].pop("section")  # the name of the key before
    tables = json.loads(json.dumps(found.as_dict()))
    assert tables["prior"]["pre_inflation"].pop("distribution") == "normal"
    assert tables.pop("p_values") == {}  # came later, as did the next three
    assert tables.pop("resimulation") is None
    assert tables.pop("reynolds_number") < 1e-3
    assert tables["inputs"].pop("flow_rate")["value"] == found.measurement.flow_rate
    assert tables == written
    assert found.draws["size_ratio"].shape == found.draws["lp"].shape == (2, 5)
    assert found.outlines.shape == (2, 16, 2)
    assert found.measurement.outline.view == SILHOUETTE
    assert found.experiment.viscosity.cdf(0.85) == pytest.approx(scipy.stats.gamma(400.0, scale=0.002125).cdf(0.85))
    assert found.prior.coordinates["pre_inflation"].ppf(0.5) == pytest.approx(0.03)


def test_a_distribution_without_a_name_is_said(posterior, tmp_path):
    counts = np.histogram(np.random.default_rng(1).normal(0.85, 0.02, 500), bins=20)
    drawn = scipy.stats.rv_histogram(counts, density=False).freeze()
    path = replace(posterior, experiment=replace(posterior.experiment, viscosity=drawn)).write(tmp_path / "one.nc")
    with pytest.raises(InputError, match=r"a distribution of scipy\.stats named") as caught:
        Posterior.read(path)
    assert "\n" not in str(caught.value)


def test_other_files_are_said(posterior, tmp_path):
    with pytest.raises(InputError, match=r"none\.nc: expected a file of a posterior, got nothing there"):
        Posterior.read(tmp_path / "none.nc")
    (tmp_path / "text.nc").write_text("no numbers")
    with pytest.raises(
        InputError, match=r"text\.nc: expected the file of a posterior, got a file that cannot be read as one"
    ):
        Posterior.read(tmp_path / "text.nc")
    path = posterior.write(tmp_path / "old.nc")
    with h5netcdf.File(path, "a") as file:
        del file.attrs[RECORD]
    with pytest.raises(InputError, match="got one that lacks what makes it whole; identify the capsule again"):
        Posterior.read(path)


def test_a_file_of_a_version_that_knew_no_doubt_about_walls_is_read(posterior, tmp_path):
    path = posterior.write(tmp_path / "old.nc")
    with h5netcdf.File(path, "a") as file:
        record = json.loads(file.attrs[RECORD])
        del record["measurement"]["doubt"]
        file.attrs[RECORD] = json.dumps(record)
    found = Posterior.read(path)
    check_same(posterior, found)
    assert found.measurement.doubt == ""


def test_the_summary_has_medians_and_named_intervals(posterior):
    table = posterior.summary()
    assert list(table.index) == list(REPORTED)
    wanted = ["unit", "mean", "sd", "median", "lower_68", "upper_68", "lower_95", "upper_95"]
    assert list(table.columns) == wanted
    assert table.loc["capsule_radius", "unit"] == "m"
    assert np.all(table["lower_95"] < table["lower_68"])
    assert np.all(table["lower_68"] < table["median"])


def test_what_a_notebook_shows_is_one_line(posterior):
    modulus = posterior.marginals["surface_shear_modulus"]
    low, middle, high = (f"{1e3 * one:.4g}" for one in (modulus.lower_95, modulus.median, modulus.upper_95))
    assert repr(posterior).startswith(f"<Posterior of a capsule: G_s = {middle} [{low}, {high}] mN/m, a = ")
    assert repr(posterior).endswith("µm (95 %); DONE>")


def test_a_quantity_is_found_by_its_name_or_symbol_and_the_corner_is_drawn(posterior):
    assert posterior["G_s"] is posterior["surface_shear_modulus"] is posterior.marginals["surface_shear_modulus"]
    with pytest.raises(InputError, match=r"one of surface_shear_modulus \(G_s\), .*, got 'K'"):
        posterior["K"]
    assert {ax.get_label() for ax in posterior.plot().axes} >= {"surface_shear_modulus", "capsule_radius"}


def test_everything_but_the_draws_is_json(posterior):
    content = json.loads(json.dumps(posterior.as_dict(), allow_nan=False))
    assert content["status"] == "DONE"
    assert content["engine"] == "quadrature"
    assert content["seed"] == 4
    assert content["model"]["sha256"] == "0" * 64
    assert content["inputs"]["axial_extent"] == {"value": 2.14, "error": 0.01, "unit": "l"}
    assert content["inputs"]["viscosity"]["unit"] == "Pa s"
    assert content["prior"]["capsule_radius"]["distribution"] == "uniform"
    assert all(gate["passed"] for gate in content["gates"])


def test_the_file_is_read_by_arviz_and_by_xarray(posterior, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # ArviZ announces its next version once a day
        import arviz
    path = posterior.write(tmp_path / "new" / "posterior.nc")
    data = arviz.from_netcdf(path, engine="h5netcdf")
    assert set(data.groups()) == {"posterior", "posterior_predictive", "observed_data", "constant_data"}
    for name in (*REPORTED, "viscosity", "half_width"):
        np.testing.assert_array_equal(data.posterior[name].values, posterior.draws[name])
    assert data.posterior["surface_shear_modulus"].attrs["units"] == "N/m"
    assert float(data.observed_data["axial_extent"]) == 2.14
    assert float(data.constant_data["axial_length_error"]) == 0.01
    with xr.open_dataset(path, group="posterior", engine="h5netcdf") as group:
        assert "ensemble" in group.coords
        assert group.sizes["chain"] == 4
    with xr.open_dataset(path, engine="h5netcdf") as root:
        assert root.attrs["status"] == "DONE"
        assert root.attrs["seed"] == 4
        assert json.loads(root.attrs["model"])["name"] == "manufactured polynomial"
        assert json.loads(root.attrs["prior"]) == posterior.prior.described()
        assert len(json.loads(root.attrs["gates"])) == len(posterior.gates)


def test_the_same_groups_are_an_inference_data(posterior, model):
    data = posterior.to_inference_data(model)
    assert data.posterior.sizes["draw"] == posterior.draws["size_ratio"].shape[1]
    assert data.posterior_predictive["outline"].shape[-1] == 2


def test_nothing_is_left_of_a_file_that_could_not_be_written(posterior, tmp_path, monkeypatch):
    def broken(*args, **keywords):
        raise OSError("disk full")

    monkeypatch.setattr(h5netcdf, "File", broken)
    with pytest.raises(InputError, match="a file that can be written, got disk full"):
        posterior.write(tmp_path / "posterior.nc")
    assert list(tmp_path.iterdir()) == []


def test_reading_and_writing_needs_no_arviz_matplotlib_or_dask():
    code = (
        "import sys, capsbayes.infer; "
        "bad = {'arviz', 'matplotlib', 'dask', 'distributed', 'cv2', 'pandas', 'emcee'} & set(sys.modules); "
        "assert not bad, bad"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
