"""Formulas of viscosities within the ranges in which they were fitted, and beyond."""

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import MEDIA, MEDIUM_ERROR, SHEAR_RATES, cheng, methylcellulose, silicone_oil, water_glycerol

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
