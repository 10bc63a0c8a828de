import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from capsbayes import experiment as physics
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.quantity import Quantity

GOOD = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 Pa s"\n'


def written(tmp_path, text):
    path = tmp_path / "experiment.toml"
    path.write_text(text)
    return path


def test_a_file_is_read_and_written_again(tmp_path):
    experiment = Experiment.read(written(tmp_path, GOOD))
    assert (experiment.cross_section, experiment.frame_rate, len(experiment.sha256)) == ("square", None, 64)
    assert (experiment.half_width.mean, experiment.half_width.sd) == pytest.approx((25e-6, 0.2e-6))
    assert experiment.viscosity.value == pytest.approx(0.85)
    assert experiment.source.endswith("experiment.toml")
    older = GOOD.replace("cross_section", "section")
    assert Experiment.read(written(tmp_path, older)).cross_section == "square"
    more = GOOD + 'frame_rate = "2.0 +/- 0.01 kHz"\nmembrane_thickness = "0.6 +/- 0.2 um"\n'
    stated = Experiment.read(written(tmp_path, more))
    rate, thickness = stated.frame_rate, stated.membrane_thickness
    assert (rate.value, rate.error, rate.unit) == (pytest.approx(2000.0), pytest.approx(10.0), "1/s")
    assert (thickness.value, thickness.error, thickness.unit) == (pytest.approx(6e-7), pytest.approx(2e-7), "m")
    assert stated.described()["membrane_thickness"] == "0.6 +/- 0.2 µm"
    stated.write(tmp_path / "again.toml")
    assert Experiment.read(tmp_path / "again.toml").membrane_thickness == thickness


def test_a_sheet_of_incompressible_material_bends_like_a_plate():
    """Its modulus E t^3 / (12 (1 - nu^2)) over G_s a^2, with E t = 3 G_s at nu = 1/2."""
    shear_modulus, thickness, radius = 0.04, 0.5e-6, 20e-6
    young, poisson = 3.0 * shear_modulus / thickness, 0.5
    plate = young * thickness**3 / (12.0 * (1.0 - poisson**2))
    found = physics.bending(membrane_thickness=thickness, capsule_radius=radius)
    assert found == pytest.approx(plate / (shear_modulus * radius**2))
    assert physics.membrane_thickness(bending=found, capsule_radius=radius) == pytest.approx(thickness)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("square", "triangular"), 'cross_section: expected "square" or "circular", got \'triangular\''),
        (("um", "Pa"), "half_width: expected a text in m like \"25.0 +/- 0.2 um\", got '25.0 +/- 0.2 Pa'"),
        (("0.85", "nan"), "viscosity: expected a positive finite number"),
        (
            ("viscosity", "viscocity"),
            "viscocity: expected one of cross_section, half_width, viscosity, viscous_tension",
        ),
        (('viscosity = "0.85 Pa s"', ""), "viscosity, viscous_tension: expected one of the two"),
        (('"0.85 Pa s"', '"0.85 Pa s"\nviscous_tension = "0.028 N/m"'), "viscosity, viscous_tension: expected one of"),
        (('viscosity = "0.85 Pa s"', 'viscous_tension = "0.028 Pa s"'), "viscous_tension: expected a text in N/m"),
        (('"0.85 Pa s"', "0.85"), "viscosity: expected a text in Pa s"),
        (('"0.85 Pa s"', '"0.85 Pa s"\nframe_rate = "2000"'), "frame_rate: expected a text in 1/s"),
        (('"0.85 Pa s"', '"0.85 Pa s"\nsection = "circular"'), "section: expected one of cross_section, "),
        (('"0.85 Pa s"', '"0.85 Pa s"\ncamera = 3'), "camera: expected a table [camera], got 3"),
    ],
)
def test_mistakes_name_file_key_expected_and_got(tmp_path, change, message):
    with pytest.raises(InputError) as caught:
        Experiment.read(written(tmp_path, GOOD.replace(*change)))
    assert f"experiment.toml: {message}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_viscosity_times_velocity_may_be_known_alone(tmp_path):
    known = Experiment(cross_section="circular", half_width="2.0 mm", viscous_tension="28 +/- 1 mN/m")
    assert known.viscosity is None
    assert np.isnan(known.reynolds_number(5e-3))
    known.write(tmp_path / "e.toml")
    again = Experiment.read(tmp_path / "e.toml")
    assert (again.viscous_tension.value, again.viscous_tension.error) == (0.028, 0.001)
    assert again.viscosity is None
    assert again.described()["viscous_tension"] == "28 +/- 1 mN/m"
    assert "viscosity" not in again.described()


def test_values_that_are_not_positive_are_refused():
    for value in (0.0, -1.0, np.nan, np.inf, "-25 um", None, True, stats.norm(1.0, 1.0), stats.cauchy(9.0)):
        with pytest.raises(InputError, match="experiment: half_width: expected a positive"):
            Experiment(cross_section="square", half_width=value, viscosity=1.0)


def test_any_positive_frozen_distribution_will_do():
    for value in (stats.lognorm(0.1, scale=1e-5), stats.uniform(1e-5, 2e-5), stats.norm(1e-5, 1e-7)):
        width = Experiment(cross_section="circular", half_width=value, viscosity=1.0).half_width
        assert (width.mean, width.sd) == pytest.approx((value.mean(), value.std()))
        np.testing.assert_allclose(width.ppf([0.1, 0.9]), value.ppf([0.1, 0.9]))
        np.testing.assert_allclose(width.logpdf(width.mean), value.logpdf(width.mean))


MICRO = pint.UnitRegistry()


def test_every_form_of_a_number_is_read():
    pints = 25.0 * MICRO.um, 0.025 * MICRO.mm
    for value in (25e-6, np.float32(25e-6), "25 um", "0.025 mm", *pints, Quantity(25e-6, unit="m")):
        width = Experiment(cross_section="square", half_width=value, viscosity="0.85 +/- 0.02 Pa s").half_width
        assert (width.value, width.error, width.unit) == (pytest.approx(25e-6), 0.0, "m")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("half_width", 25, 'a value from 1e-07 to 0.1 m, got 25 m (read in m); did you mean "25 um"?'),
        ("viscosity", 1e9, "a value from 1e-06 to 1000 Pa s, got 1e+09 Pa s (read in Pa s); check"),
        ("half_width", 0.85 * MICRO.pascal, "half_width: expected a quantity in m, got 0.85 pascal"),
        ("half_width", Quantity(0.85, unit="Pa s"), "half_width: expected a quantity in m, got one in Pa s"),
        ("membrane_thickness", 0.6, "membrane_thickness: expected a value from "),
    ],
)
def test_a_number_that_no_experiment_has_names_the_unit_it_was_read_in(key, value, message):
    given = {"half_width": 25e-6, "viscosity": 0.85} | {key: value}
    with pytest.raises(InputError) as caught:
        Experiment(cross_section="square", **given)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.floats(1e-3, 1e3), st.floats(1e-2, 2.0))
def test_a_normal_cut_at_zero_has_no_negative_part(mean, share):
    frozen = Quantity(mean, share * mean)
    assert frozen.cdf(0.0) == 0.0
    assert frozen.pdf(mean) >= stats.norm(mean, share * mean).pdf(mean) * (1.0 - 1e-14)


@given(st.floats(0.01, 2.0), st.floats(1e-4, 0.1), st.floats(1e-3, 1.0), st.floats(1e-5, 1e-4), st.floats(0.7, 2.0))
def test_si_and_ratios_are_inverse_to_each_other(viscosity, velocity, modulus, width, ratio):
    ca = physics.capillary_number(viscosity=viscosity, mean_velocity=velocity, surface_shear_modulus=modulus)
    back = physics.surface_shear_modulus(viscosity=viscosity, mean_velocity=velocity, capillary_number=ca)
    assert back == pytest.approx(modulus)
    radius = physics.capsule_radius(size_ratio=ratio, half_width=width)
    assert physics.size_ratio(capsule_radius=radius, half_width=width) == pytest.approx(ratio)
    assert physics.mean_velocity(capsule_velocity=ratio * velocity, velocity_ratio=ratio) == pytest.approx(velocity)
