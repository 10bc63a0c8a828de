"""A posterior that contradicts its measurement says so, and ends within seconds."""

import time
from dataclasses import replace

import numpy as np
import pytest

from capsbayes import Experiment, Measurement, MembraneSurrogate, Posterior, Surrogate, identify
from capsbayes.errors import InputError
from capsbayes.infer import Prior
from capsbayes.infer.batch import identify_folder
from capsbayes.infer.checks import REFUSED_P
from capsbayes.physics.channel import cross_section_named
from capsbayes.report.posterior import caveats, check_table
from capsbayes.status import Status

RATE = "0.71 +/- 0.01 uL/min"


@pytest.fixture(scope="module")
def surrogate():
    return Surrogate.open("square-neo-hookean")


@pytest.fixture(scope="module")
def channel():
    return Experiment.read("examples/ovalbumin/experiment.toml")


@pytest.fixture(scope="module")
def ovalbumin():
    return Measurement.read("examples/ovalbumin/capsule.toml")


@pytest.mark.parametrize("engine", ["emcee", "quadrature"])
@pytest.mark.parametrize("prior", ["200 .. 400 mN/m", "300 .. 400 mN/m", "500 +/- 20 mN/m"])
def test_a_prior_in_conflict_with_the_lengths_is_said_within_seconds(surrogate, channel, ovalbumin, prior, engine):
    identify(ovalbumin, surrogate, channel, seed=1, engine="quadrature", prior=Prior(prior))  # compiles, at first
    begun = time.process_time()
    posterior = identify(ovalbumin, surrogate, channel, seed=1, engine=engine, prior=Prior(prior))
    assert time.process_time() - begun < 30.0
    assert posterior.status is Status.LENGTHS_MISFIT
    assert min(posterior.p_values.values()) < 1e-6
    assert any("predictive p-value of L_" in sentence for sentence in caveats(posterior))


@pytest.mark.parametrize("engine", ["emcee", "quadrature"])
@pytest.mark.parametrize("prior", ["5 +/- 0.1 mN/m", "log-normal 5 +/- 0.1 mN/m", "4 .. 5 mN/m", "5 +/- 0.01 N/m"])
def test_a_prior_that_holds_no_shape_is_refused_with_what_the_shapes_have(surrogate, channel, ovalbumin, prior, engine):
    with pytest.raises(
        InputError, match=r"prior\.surface_shear_modulus: expected G_s from .* as shapes of these lengths"
    ):
        identify(ovalbumin, surrogate, channel, seed=1, engine=engine, prior=Prior(prior))


def test_it_is_refused_with_the_membrane_unknown_too(channel, ovalbumin):
    model = MembraneSurrogate.open("square")
    for prior in (Prior("5 +/- 0.1 mN/m"), Prior(capsule_radius="100 +/- 0.2 um")):
        with pytest.raises(InputError, match="as shapes of these lengths have, got the prior"):
            identify(ovalbumin, model, channel, seed=1, prior=prior)


def test_p_values_are_reported_everywhere(surrogate, channel, ovalbumin, tmp_path):
    posterior = identify(replace(ovalbumin, flow_rate=RATE), surrogate, channel, seed=1, engine="quadrature")
    assert posterior.status is Status.DONE
    assert list(posterior.p_values) == ["axial_extent", "axial_length", "flow_rate"]
    assert posterior.as_dict()["p_values"] == posterior.p_values
    assert [f"predictive p-value of {name}" in check_table(posterior).to_string() for name in ("L_z", "L_a", "Q")]
    again = Posterior.read(posterior.write(tmp_path / "posterior.nc"))
    assert again.as_dict() == posterior.as_dict()
    assert again.measurement.flow_rate_error == posterior.measurement.flow_rate_error > 0.0


@pytest.mark.parametrize(
    ("capsule", "experiment"),
    [
        ({"flow_rate": "10 +/- 0.1 uL/min"}, {}),
        ({"capsule_velocity": "62 +/- 0.6 mm/s"}, {}),
        ({}, {"half_width": "50.0 +/- 0.4 um"}),
    ],
    ids=["flow rate of another pump", "velocity ten times too large", "full width as half width"],
)
@pytest.mark.parametrize("engine", ["emcee", "quadrature"])
def test_two_sources_of_the_mean_velocity_in_conflict_are_said(
    surrogate, channel, ovalbumin, capsule, experiment, engine
):
    seen, known = replace(ovalbumin, **{"flow_rate": RATE} | capsule), replace(channel, **experiment)
    posterior = identify(seen, surrogate, known, seed=1, engine=engine)
    assert posterior.status is Status.FLOW_CONFLICT
    assert posterior.p_values["flow_rate"] < 1e-6


def test_rows_of_a_table_say_the_same(surrogate, channel, tmp_path):
    lines = [
        "axial_extent_over_l,axial_extent_error_over_l,axial_length_over_l,axial_length_error_over_l,"
        "capsule_velocity_mm_per_s,capsule_velocity_error_mm_per_s,flow_rate_ul_per_min,flow_rate_error_ul_per_min,"
        "surface_shear_modulus_prior,half_width_um,viscosity_mpa_s",
        "2.14,0.02,1.81,0.02,6.2,0.06,0.71,0.01,,,",
        "2.14,0.02,1.81,0.02,6.2,0.06,10,0.1,,,",
        "2.14,0.02,1.81,0.02,6.2,0.06,0.71,,,,",
        "2.14,0.02,1.81,0.02,6.2,0.06,,,200 .. 400 mN/m,,",
        "2.14,0.02,1.81,0.02,6.2,0.06,,,50 +/- 10 mN/m,,",
        "2.14,0.02,1.81,0.02,6.2,0.06,,,50 mN/m,,",
        "2.14,0.02,1.81,0.02,6.2,0.06,,,5 +/- 0.1 mN/m,,",
        "2.14,0.02,1.81,0.02,1200,12,,,,50,1",
    ]
    table = tmp_path / "capsules.csv"
    table.write_text("\n".join(lines) + "\n")
    found = identify_folder(
        table, surrogate, channel, out=tmp_path / "o.nc", seed=1, check=0.0, scheduler="synchronous"
    )
    expected = ["DONE", "FLOW_CONFLICT", "DONE", "LENGTHS_MISFIT", "DONE", "UNUSABLE", "UNUSABLE", "INERTIA"]
    assert found["status"].tolist() == expected
    assert found["p_value_flow_rate"][1] < 1e-6 < REFUSED_P < found["p_value_flow_rate"][0]
    assert found["reynolds_number"][7] > 20.0
    assert "a distribution" in found["reason"][5]
    assert "as shapes of these lengths have, got the prior 5 +/- 0.1 mN/m" in found["reason"][6]
    assert np.isnan(found["surface_shear_modulus_median"][5:7]).all()


def test_inertia_is_said_and_the_density_is_stated(surrogate, channel, ovalbumin):
    water = replace(channel, half_width="50 um", viscosity="1 mPa s")
    fast = replace(ovalbumin, capsule_velocity="1.2 +/- 0.012 m/s")
    posterior = identify(fast, surrogate, water, seed=1, engine="quadrature")
    assert posterior.status is Status.INERTIA
    assert posterior.as_dict()["reynolds_number"] == pytest.approx(46.5, abs=1.5)
    oil = replace(water, density="0.8 g/cm^3")
    assert oil.reynolds_number(1.0) == pytest.approx(0.8 / 0.998 * water.reynolds_number(1.0))


@pytest.mark.parametrize("name", ["section_aspect", "corner_radius"])
def test_areas_of_cross_sections_are_those_of_the_flow(surrogate, channel, name):
    named = {"section_aspect": "aspect", "corner_radius": "corner_radius"}[name]
    for value in (0.9, 1.1) if name == "section_aspect" else (0.1, 0.3):
        expected = cross_section_named("square", **{named: value}).area / 4.0
        assert surrogate.relative_area({"capillary_number": 0.05, name: value}) == pytest.approx(expected, rel=1e-6)
