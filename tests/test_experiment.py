"""The experiment as its file states it, viscosities of liquids by their formulas, and the geometry of a camera."""

import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from capsbayes import experiment as physics
from capsbayes.errors import InputError
from capsbayes.experiment import (
    MEDIA,
    MEDIUM_ERROR,
    SHEAR_RATES,
    Camera,
    Experiment,
    cheng,
    methylcellulose,
    silicone_oil,
    water_glycerol,
)
from capsbayes.measurement import Pose
from capsbayes.profile import vertex_normals
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
        *(
            (('"0.85 Pa s"', f'"0.85 Pa s"\n[camera]\n{line}'), f"camera.{message}")
            for line, message in (
                ('pixel_aspect = "2 %"', 'pixel_aspect: expected a text without unit like "1.020 +/- 0.005"'),
                ('pixel_aspect = "0.02"', "pixel_aspect: expected a number within 0.1 of 1 with its error"),
                ("distortion = -0.01", 'distortion: expected a text like "-0.010 +/- 0.002", got -0.01'),
                ('distortion = "-0.05 +/- 0.06"', "distortion: expected a number within 0.1 of 0 with its error"),
                ('tilt = "2 deg"', "tilt: expected one of pixel_aspect, distortion, taper, got an unknown key"),
            )
        ),
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


BEYOND = "flow_rate, half_width: expected a shear rate at the wall from 2500 to 300000"


@pytest.mark.parametrize("medium", MEDIA)
@pytest.mark.parametrize("degrees", [22.0, 37.0])
def test_methylcellulose_is_thicker_than_water_and_less_sure_beyond_the_range(medium, degrees):
    rates = np.geomspace(0.55 * SHEAR_RATES[0], 1.8 * SHEAR_RATES[1], 30)  # to 6 %, which the exponent changes
    found = [methylcellulose(medium, degrees, rate * 1e-15, "10 um") for rate in rates]
    assert all(viscosity.value > 2.0 * cheng(0.0, degrees) for viscosity in found)
    relative = np.array([viscosity.error / viscosity.value for viscosity in found])
    within = (rates > 1.1 * SHEAR_RATES[0]) & (rates < 0.9 * SHEAR_RATES[1])
    assert relative[within] == pytest.approx(MEDIUM_ERROR)
    assert np.all(relative[[0, -1]] > 1.4 * MEDIUM_ERROR)


@pytest.mark.parametrize("temperature", ["296.15 +/- 0.5 K", "23.0 +/- 0.5 °C", "23.0 +/- 0.5 C", "23.0 +/- 0.5"])
def test_a_temperature_may_have_its_unit(temperature):
    assert water_glycerol("0.98", temperature) == water_glycerol(0.98, "23.0 +/- 0.5 degC")
    assert silicone_oil("1000 cSt", "0.97 g/cm^3", temperature).value == pytest.approx(
        0.97 * 1.0019 * 10.0 ** (763.1 / 296.0 - 2.559)
    )


@pytest.mark.parametrize(
    ("formula", "given", "message"),
    [
        (water_glycerol, ("0.98", "101 degC"), "temperature: expected a number from 0 to 100"),
        (water_glycerol, ("0.98", "270 K"), "temperature: expected a number from 0 to 100"),
        (water_glycerol, ("98%", "23 degC"), "mass_fraction: .* got a per cent in '98%'"),
        (methylcellulose, ("0.49%", "38 degC", "0.1 uL/s", "10 um"), "temperature: expected a number from 22 to 37"),
        (methylcellulose, ("0.49%", "23 degC", "10 uL/s", "10 um"), BEYOND),
        (methylcellulose, ("0.49%", "23 degC", "1e-4 uL/s", "100 um"), BEYOND),
        (silicone_oil, ("1000 mPa s", "970 kg/m^3", "23 degC"), "kinematic_viscosity: expected a text in m"),
        (silicone_oil, ("1e7 cSt", "970 kg/m^3", "23 degC"), "kinematic_viscosity: expected from 100 to"),
        (silicone_oil, ("1000 cSt", "970 g/cm^3", "23 degC"), "density: expected a value from 100 to 30000"),
    ],
)
def test_what_a_formula_does_not_hold_for_is_refused(formula, given, message):
    with pytest.raises(InputError, match=message):
        formula(*given)


def test_glycerol_makes_water_no_thinner():
    shares, degrees = np.linspace(0.0, 1.0, 41)[:, None], np.linspace(0.0, 100.0, 21)
    assert np.all(np.diff(cheng(shares, degrees), axis=0) > 0.0)


CAMERA = Camera(pixel_aspect="1.03 +/- 0.004", distortion="-0.02 +/- 0.003", taper="0.01 +/- 0.002")
ANGLE = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
EGG = np.stack([1.1 * np.cos(ANGLE) + 0.1 * np.cos(2.0 * ANGLE), 0.8 * np.sin(ANGLE)], axis=1)


def pictured(points, aspect, distortion, taper, walls):
    """Perspective, then the lens, then pixels; all over l as it is read at the walls."""
    points = points / (1.0 - taper * points[:, :1])
    points = points * (1.0 + distortion * np.sum(points**2, axis=1, keepdims=True)) / (1.0 + distortion * walls)
    return points * [aspect, 1.0]


def test_what_is_seen_is_straightened():
    points = EGG + np.array([0.7, 0.0])
    seen = pictured(points, 1.03, -0.02, 0.01, walls=2.2)
    assert np.abs(seen - points).max() > 0.03
    np.testing.assert_allclose(CAMERA.straightened(seen, walls=2.2), points, atol=1e-6)
    np.testing.assert_array_equal(Camera().straightened(seen, walls=2.2), seen)


def test_errors_are_those_of_each_number():
    errors = CAMERA.errors_of(EGG, walls=1.5)
    means, sds = np.array([1.03, -0.02, 0.01]), np.array([0.004, 0.003, 0.002])
    for number, error in enumerate(errors):
        off = pictured(CAMERA.straightened(EGG, walls=1.5), *(means + sds * (np.arange(3) == number)), walls=1.5)
        np.testing.assert_allclose(EGG - off, error, atol=0.08 * np.abs(error).max())


def test_the_pose_of_an_outline_has_the_directions_of_the_camera():
    """The change of the normal distances by a standard error of each number, by differences of the map."""
    shifted = EGG + np.array([0.6, 0.0])
    normal = vertex_normals(EGG)
    middle = 0.5 * (shifted[:, 0].max() + shifted[:, 0].min())
    pose = Pose(pixel_aspect=0.004, distortion=0.003, taper=0.002, middle=middle, walls=1.8)
    changes = pose.directions(EGG, normal)
    assert changes.shape == (len(EGG), 7)
    sds = np.diag([0.004, 0.003, 0.002])
    for sd, change in zip(sds, changes.T[4:], strict=True):
        moved = pictured(shifted, 1.0 + sd[0], *sd[1:], walls=1.8) - shifted
        left = np.sum(moved * normal, axis=1) - change
        left -= normal[:, 0] * (left @ normal[:, 0]) / np.sum(normal[:, 0] ** 2)  # a shift along the flow
        assert np.abs(left).max() < 0.02 * np.abs(change).max()
    np.testing.assert_array_equal(Pose().directions(EGG, normal), changes[:, :4])


def test_an_experiment_states_its_camera(tmp_path):
    stated = Experiment.read(
        written(tmp_path, GOOD + '[camera]\npixel_aspect = "1.02 +/- 0.005"\ntaper = "0 +/- 0.002"\n')
    )
    camera = stated.camera
    assert camera == Camera(pixel_aspect="1.02 +/- 0.005", taper="0 +/- 0.002")
    assert list(camera.stated) == ["pixel_aspect", "taper"]
    assert stated.described()["camera"] == "pixel_aspect 1.02 +/- 0.005, taper 0.0 +/- 0.002"
    stated.write(tmp_path / "again.toml")
    assert Experiment.read(tmp_path / "again.toml").camera == camera
    assert Experiment(cross_section="square", half_width=25e-6, viscosity=0.85).camera is None
