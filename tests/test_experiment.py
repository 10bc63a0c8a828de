import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from capsbayes import experiment as physics
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, positive_normal

GOOD = 'section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 Pa s"\n'


def written(tmp_path, text):
    path = tmp_path / "experiment.toml"
    path.write_text(text)
    return path


def test_an_error_makes_a_distribution_and_no_error_a_number(tmp_path):
    experiment = Experiment.read(written(tmp_path, GOOD))
    assert experiment.section == "square"
    assert experiment.half_width.mean() == pytest.approx(25e-6)
    assert experiment.half_width.std() == pytest.approx(0.2e-6)
    assert experiment.viscosity == pytest.approx(0.85)
    assert experiment.source.endswith("experiment.toml")
    assert len(experiment.sha256) == 64
    assert experiment.frame_rate is None


def test_the_rate_of_films_may_be_stated(tmp_path):
    rate = Experiment.read(written(tmp_path, GOOD + 'frame_rate = "2.0 +/- 0.01 kHz"\n')).frame_rate
    assert (rate.value, rate.error, rate.unit) == (pytest.approx(2000.0), pytest.approx(10.0), "1/s")
    with pytest.raises(InputError, match="frame_rate: expected a text in 1/s"):
        Experiment.read(written(tmp_path, GOOD + 'frame_rate = "2000"\n'))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("square", "triangular"), 'section: expected "square" or "circular", got \'triangular\''),
        (("um", "Pa"), 'half_width: expected a text in m like "25.0 +/- 0.2 um", got pascal'),
        (("0.85", "-0.85"), "viscosity: expected a positive finite number"),
        (("0.85", "nan"), "viscosity: expected a positive finite number"),
        (
            ("viscosity", "viscocity"),
            "viscocity: expected one of section, half_width, viscosity, frame_rate, got an unknown key",
        ),
        (('viscosity = "0.85 Pa s"', ""), "viscosity: expected a value, got nothing"),
        (('"0.85 Pa s"', "0.85"), "viscosity: expected a text in Pa s"),
    ],
)
def test_mistakes_name_file_key_expected_and_got(tmp_path, change, message):
    with pytest.raises(InputError) as caught:
        Experiment.read(written(tmp_path, GOOD.replace(*change)))
    assert f"experiment.toml: {message}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "25 um", None, stats.norm(1.0, 1.0), stats.cauchy(9.0)])
def test_values_that_are_not_positive_are_refused(value):
    with pytest.raises(InputError, match=r"experiment: half_width: expected a (positive|distribution)"):
        Experiment(section="square", half_width=value, viscosity=1.0)


def test_any_positive_frozen_distribution_will_do():
    for value in (stats.lognorm(0.1, scale=1e-5), stats.uniform(1e-5, 2e-5), stats.norm(1e-5, 1e-7), np.float32(1e-5)):
        assert Experiment(section="circular", half_width=value, viscosity=1.0).half_width is value


@given(st.floats(1e-3, 1e3), st.floats(1e-2, 2.0))
def test_a_normal_cut_at_zero_has_no_negative_part(mean, share):
    frozen = positive_normal(mean, share * mean)
    assert frozen.cdf(0.0) == 0.0
    assert frozen.pdf(mean) >= stats.norm(mean, share * mean).pdf(mean)


@given(
    st.floats(0.01, 2.0),
    st.floats(1e-4, 0.1),
    st.floats(1e-3, 1.0),
    st.floats(1e-5, 1e-4),
    st.floats(0.7, 1.15),
    st.floats(1.0, 2.0),
)
def test_si_and_ratios_are_inverse_to_each_other(viscosity, velocity, modulus, width, size, ratio):
    ca = physics.capillary_number(viscosity=viscosity, mean_velocity=velocity, surface_shear_modulus=modulus)
    back = physics.surface_shear_modulus(viscosity=viscosity, mean_velocity=velocity, capillary_number=ca)
    assert back == pytest.approx(modulus)
    radius = physics.capsule_radius(size_ratio=size, half_width=width)
    assert physics.size_ratio(capsule_radius=radius, half_width=width) == pytest.approx(size)
    assert physics.mean_velocity(capsule_velocity=ratio * velocity, velocity_ratio=ratio) == pytest.approx(velocity)
