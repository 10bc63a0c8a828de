"""Predictions, likelihoods and statistics of a posterior for ArviZ, compared with the engines that know them too."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from capsbayes.errors import InputError
from capsbayes.infer import identify
from capsbayes.infer.importance import exact_engine
from capsbayes.infer.posterior import Posterior
from capsbayes.infer.predictive import Predictive
from capsbayes.infer.prior import Prior

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import arviz


@pytest.fixture(scope="module")
def seen(capsule):
    return replace(capsule, flow_rate=0.6e-9 / 60.0, flow_rate_error=0.05e-9 / 60.0)


@pytest.fixture(scope="module")
def sampled(seen, model, experiment):
    return identify(seen, model, experiment, engine="emcee", seed=4)


@pytest.fixture(scope="module")
def data(sampled, model):
    return sampled.to_inference_data(model)


def test_the_density_is_that_which_the_chains_climbed(sampled, model):
    parts = sampled.draws, sampled.measurement, sampled.experiment, sampled.prior, sampled.inputs, model, 1
    again = Predictive(*parts).groups()["sample_stats"]["lp"]
    assert np.std(again - sampled.draws["lp"]) < 1e-6 * np.std(again)


def test_a_chain_of_arviz_is_an_ensemble(sampled, data):
    """With its walkers one after the other: a quarter of a thousand chains made its plots take minutes."""
    assert data.posterior.sizes["chain"] == len(np.unique(sampled.ensemble)) <= 8
    for name, values in data.posterior.items():
        np.testing.assert_array_equal(np.sort(values, axis=None), np.sort(sampled.draws[name], axis=None))
    walkers = xr.Dataset({"a": (("chain", "draw"), sampled.draws["capsule_radius"])})
    assert float(arviz.ess(data)["capsule_radius"]) == pytest.approx(float(arviz.ess(walkers)["a"]), rel=0.2)
    assert float(arviz.rhat(data)["capsule_radius"]) < 1.01


def test_how_much_the_prior_matters_is_what_arviz_says_of_its_densities(sampled, data, seen, model, experiment):
    modulus = data.posterior["surface_shear_modulus"].values
    assert np.allclose(data.log_prior["surface_shear_modulus"], -np.log(modulus * np.log(1e5)))
    for name, found in sampled.prior_sensitivity.items():
        assert found == pytest.approx(float(arviz.psens(data)[name]), rel=1e-6)
        assert found < 0.05
    middle = sampled["G_s"].median
    stated = Prior(G_s=f"{1.1 * middle} +/- {0.2 * sampled['G_s'].sd} N/m")
    narrow = identify(seen, model, experiment, engine="quadrature", seed=4, prior=stated)
    assert narrow.prior_sensitivity["surface_shear_modulus"] > 0.1


def test_the_prior_is_that_which_the_quadrature_integrates(data, seen, model, experiment):
    engine = exact_engine(model, experiment)
    points, logs = engine.predicted_shapes(engine(replace(seen, flow_rate=None)).density)
    weights = np.exp(logs - logs.max()) / np.exp(logs - logs.max()).sum()
    for name, values in (("axial_extent", points.extent), ("axial_length", points.length)):
        mean, drawn = weights @ values, data.prior_predictive[name].values.ravel()
        sd = np.sqrt(weights @ (values - mean) ** 2)
        assert drawn.mean() == pytest.approx(mean, abs=4.0 * sd / np.sqrt(len(drawn)) + 0.01 * sd)
        assert drawn.std() == pytest.approx(sd, rel=0.1)


def test_measurements_that_the_posterior_predicts_are_like_the_one_made(data, seen):
    for name, error in (
        ("axial_extent", seen.axial_extent_error),
        ("axial_length", seen.axial_length_error),
        ("capsule_velocity", seen.capsule_velocity_error),
        ("flow_rate", seen.flow_rate_error),
    ):
        drawn = data.posterior_predictive[name].values
        assert drawn.std() > 0.97 * error
        assert abs(drawn.mean() - getattr(seen, name)) < 3.0 * drawn.std()
    drawn = data.posterior_predictive["capsule_velocity"].values
    both = np.hypot(seen.capsule_velocity_error, data.posterior["capsule_velocity"].values.std())
    assert drawn.std() == pytest.approx(both, rel=0.05)


def test_arviz_works_on_it(data):
    import matplotlib.pyplot as plt

    assert {"lengths", "capsule_velocity", "flow_rate"} == set(data.log_likelihood)
    axes = arviz.plot_ppc(data, var_names=["axial_extent", "capsule_velocity"], kind="cumulative", num_pp_samples=20)
    assert len(np.ravel(axes)) == 2
    plt.close("all")


def test_a_summary_in_units_that_people_read(sampled, model, tmp_path):
    shown = sampled.to_inference_data(model, units="shown")
    table = arviz.summary(shown, var_names=["G_s [mN/m]", "a [µm]", "v_o [mm/s]"], kind="stats")
    means = [sampled.draws[name].mean() for name in ("surface_shear_modulus", "capsule_radius", "capsule_velocity")]
    assert list(table["mean"]) == pytest.approx(np.array(means) * [1e3, 1e6, 1e3], abs=6e-4)
    assert {"L_z [l]", "v_o [mm/s]"} <= set(shown.observed_data)
    with pytest.raises(InputError, match="units: expected"):
        sampled.to_inference_data(model, units="cgs")
    read = Posterior.read(sampled.write(tmp_path / "posterior.nc"))
    assert set(read.to_inference_data(model).groups()) == set(shown.groups())
    with pytest.raises(InputError, match="no such database comes with the library"):
        read.to_inference_data()
