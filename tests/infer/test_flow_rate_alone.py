"""A flow rate in place of the velocity: U = Q/A and G_s = mu U/Ca, with the half width in both A and a."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from capsbayes.diagnosis import Session
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer import Posterior, Prior, identify
from capsbayes.infer.batch import identify_folder
from capsbayes.infer.hierarchy import hierarchy
from capsbayes.infer.importance import exact_engine
from capsbayes.measurement import Measurement
from capsbayes.measurement_sets import read_set, write_set
from capsbayes.plan import error_budget
from capsbayes.quantity import Quantity
from capsbayes.surrogate import Surrogate

LAB = Experiment("square", "25.0 +/- 0.4 um", "0.80 +/- 0.02 Pa s")
RATE = 4.0 * 25e-6**2 * 3.75e-3
SEEN = Measurement("1.9475 +/- 0.003", axial_length="1.712 +/- 0.003", flow_rate=RATE, flow_rate_error=0.01 * RATE)


@pytest.fixture(scope="module")
def surrogate():
    return Surrogate.open("square-neo-hookean")


@pytest.mark.parametrize(
    "prior",
    [
        Prior(),
        Prior(surface_shear_modulus=Quantity.uniform(1e-3, 0.2)),
        Prior(surface_shear_modulus=Quantity.log_uniform(0.03, 0.049)),
        Prior(surface_shear_modulus=Quantity(0.045, 0.002)),
    ],
    ids=["range of the log", "range", "a range that cuts", "normal"],
)
def test_the_posterior_is_that_of_independent_inputs(surrogate, prior):
    """Shapes, mu, l and Q drawn apart and weighted by the prior of mu Q/(4 l^2 Ca) give the same quantiles."""
    rng, count = np.random.default_rng(1), 200_000
    shapes = exact_engine(surrogate, LAB, Prior())(SEEN).drawn(rng, count)
    width, viscosity = rng.normal(25e-6, 0.4e-6, count), rng.normal(0.80, 0.02, count)
    flow = rng.normal(RATE, 0.01 * RATE, count) / (4.0 * width**2)
    modulus = viscosity * flow / shapes["capillary_number"]
    known = prior.surface_shear_modulus
    weights = np.exp(known.log_weight(modulus) + known.power * np.log(modulus))
    truth = {
        "surface_shear_modulus": modulus,
        "capsule_radius": width * shapes["size_ratio"],
        "mean_velocity": flow,
        "half_width": width,
    }
    posterior = exact_engine(surrogate, LAB, prior)(SEEN)
    drawn = posterior.drawn(rng, count)
    for name, values in truth.items():
        order = np.argsort(values)
        below = np.cumsum(weights[order]) / weights.sum()
        wanted = values[order][np.searchsorted(below, (0.025, 0.5, 0.975))]
        sd, found = (wanted[2] - wanted[0]) / 3.92, posterior.marginal(name)
        np.testing.assert_allclose((found.lower_95, found.median, found.upper_95), wanted, atol=0.15 * sd)
        np.testing.assert_allclose(np.quantile(drawn[name], (0.025, 0.5, 0.975)), wanted, atol=0.15 * sd)
    np.testing.assert_allclose(drawn["capsule_velocity"], drawn["mean_velocity"] * drawn["velocity_ratio"])


@pytest.fixture(scope="module")
def posterior(surrogate):
    return identify(SEEN, surrogate, LAB, seed=1)


def test_emcee_agrees_and_the_shares_add_up(posterior, surrogate):
    assert posterior.status.ok
    assert posterior.agreement.passed
    variance = posterior.log_modulus_sd**2
    assert posterior.shares["flow_rate"] == pytest.approx(0.01**2 / variance, rel=0.1)
    assert posterior.shares["half_width"] == pytest.approx((2.0 * 0.016) ** 2 / variance, rel=0.1)
    assert "capsule_velocity" not in posterior.shares
    assert sum(posterior.shares.values()) == pytest.approx(1.0)
    assert abs(posterior.shares["prior and curvature"]) < 0.02
    rows = {row.name: row for row in error_budget(posterior, surrogate).rows}
    slopes = {name: rows[name].log_slope["surface_shear_modulus"] for name in ("flow_rate", "half_width")}
    assert slopes == pytest.approx({"flow_rate": 1.0, "half_width": -2.0}, abs=0.02)


def test_a_velocity_is_neither_invented_nor_checked(posterior, surrogate, tmp_path):
    assert "flow_rate" not in posterior.p_values
    assert "capsule_velocity" not in posterior.as_dict()["inputs"]
    again = Posterior.read(posterior.write(tmp_path / "p.nc"))
    assert again.as_dict() == posterior.as_dict()
    assert again.inputs.by_flow_rate
    groups = again.to_inference_data(model=surrogate)
    assert "capsule_velocity" not in groups["log_likelihood"]
    assert "capsule_velocity" not in groups["observed_data"]
    ratio = groups["prior"]["capsule_velocity"] / groups["prior"]["velocity_ratio"] / (RATE / 25e-6**2 / 4.0)
    assert float(np.std(np.log(ratio))) == pytest.approx(np.hypot(0.01, 2.0 * 0.016), rel=0.1)


def test_a_file_a_table_and_a_netcdf_file_state_it_in_place_of_the_velocity(surrogate, tmp_path):
    SEEN.write(tmp_path / "capsule.toml")
    assert Measurement.read(tmp_path / "capsule.toml").described() == SEEN.described() | {
        "source": str(tmp_path / "capsule.toml")
    }
    LAB.write(tmp_path / "experiment.toml")
    with_velocity = replace(SEEN, capsule_velocity="4.86 +/- 0.05 mm/s")
    write_set(tmp_path / "set.csv", [SEEN, with_velocity], LAB)
    read = read_set(tmp_path / "set.csv", LAB).measurements
    assert [one.capsule_velocity for one in read] == [None, pytest.approx(4.86e-3)]
    found = identify_folder(
        tmp_path / "set.csv", surrogate, LAB, out=tmp_path / "found.nc", seed=1, check=0.0, scheduler="synchronous"
    )
    medians = [identify(one, surrogate, LAB, seed=1, engine="quadrature").marginals for one in (SEEN, with_velocity)]
    for row, wanted in enumerate(medians):
        for name in ("surface_shear_modulus", "mean_velocity"):
            assert found[f"{name}_median"][row] == pytest.approx(wanted[name].median, abs=0.05 * wanted[name].sd)
    rows = {"axial_extent_over_l": [1.95, 1.95], "axial_extent_error_over_l": [0.01, 0.01]}
    neither = pd.DataFrame(rows | {"flow_rate_ul_per_min": [0.56, np.nan], "capsule_velocity_mm_per_s": [np.nan] * 2})
    neither.assign(capsule_velocity_error_mm_per_s=np.nan).to_csv(tmp_path / "t.csv", index=False)
    left_out = read_set(tmp_path / "t.csv", LAB).left_out
    assert len(left_out) == 1
    assert "capsule_velocity: expected a positive finite number, got nan" in left_out[0]


def test_a_flow_rate_alone_has_an_error(surrogate):
    with pytest.raises(InputError, match="flow_rate: expected a standard error, as no velocity is stated, got none"):
        identify(replace(SEEN, flow_rate_error=0.0), surrogate, LAB, seed=1)


def test_what_needs_a_velocity_says_so():
    with pytest.raises(InputError, match=r"capsule_velocity: expected .*, got nothing; this needs v_o"):
        Session([SEEN], LAB).circumstances  # noqa: B018


def test_the_errors_of_the_pump_and_of_the_channel_do_not_average_out(surrogate, tmp_path):
    """Twenty capsules know their median G_s no better than mu and Q/A are."""
    rng = np.random.default_rng(2)
    modulus, sizes = 0.05 * np.exp(0.1 * rng.standard_normal(20)), rng.uniform(0.8, 0.96, 20)
    shapes = surrogate({"capillary_number": 3.0e-3 / modulus, "size_ratio": sizes})
    rows = [
        replace(SEEN, axial_extent=extent + 0.003 * errors[0], axial_length=length + 0.003 * errors[1])
        for extent, length, errors in zip(
            shapes.axial_extent, shapes.axial_length, rng.standard_normal((20, 2)), strict=True
        )
    ]
    write_set(tmp_path / "set.csv", rows, LAB)
    found = identify_folder(
        tmp_path / "set.csv", surrogate, LAB, out=tmp_path / "found.nc", seed=1, check=0.0, scheduler="synchronous"
    )
    together = hierarchy(found, seed=1)
    log_modulus, log_radius = (np.log(together.draws[name]) for name in ("surface_shear_modulus", "capsule_radius"))
    alone = np.std(np.log(together.without_shared["surface_shear_modulus"]))
    assert np.std(log_modulus) == pytest.approx(np.sqrt(alone**2 + 0.025**2 + 0.01**2 + (2.0 * 0.016) ** 2), rel=0.05)
    assert np.corrcoef(log_modulus, log_radius)[0, 1] < -0.2  # a wider channel: a larger, and slower flow
    assert alone == pytest.approx(0.1 / np.sqrt(20.0), rel=0.5)
