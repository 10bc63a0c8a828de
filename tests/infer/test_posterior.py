import json
import warnings

import numpy as np
import pytest
import xarray as xr

from capsbayes.errors import InputError
from capsbayes.infer import identify
from capsbayes.infer.posterior import REPORTED


@pytest.fixture(scope="module")
def posterior(model, experiment, capsule):
    return identify(capsule, model, experiment, engine="quadrature", seed=4)


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
    import h5netcdf

    def broken(*args, **keywords):
        raise OSError("disk full")

    monkeypatch.setattr(h5netcdf, "File", broken)
    with pytest.raises(InputError, match="a file that can be written, got disk full"):
        posterior.write(tmp_path / "posterior.nc")
    assert list(tmp_path.iterdir()) == []


def test_reading_and_writing_needs_no_arviz_matplotlib_or_dask():
    import subprocess
    import sys

    code = (
        "import sys, capsbayes.infer; "
        "bad = {'arviz', 'matplotlib', 'dask', 'distributed', 'cv2', 'pandas', 'emcee'} & set(sys.modules); "
        "assert not bad, bad"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
