"""Viscosity of a suspending liquid from what it was made of: with its error, and where it comes from."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.quantity import Given, Quantity

FORMULA_ERROR = 0.04
"""Relative standard error of the formula of `water_glycerol` itself."""

SOURCE = "Cheng 2008, https://doi.org/10.1021/ie071349z"

OIL_ERROR = 0.03
"""Relative standard error of the formula of `silicone_oil`, for oils of 100 mm^2/s and more."""

OIL_SOURCE = "Shin-Etsu, Silicone fluid KF-96, performance test results"

MEDIUM_ERROR = 0.12
"""Relative standard error of `methylcellulose`: half of the largest difference between two published formulas."""

MEDIUM_SOURCE = "Büyükurganci et al. 2023, https://doi.org/10.1039/D2SM01515C"

SHEAR_RATES = 5e3, 1.5e5
"""Shear rates [1/s] at which methylcellulose was measured to be a power-law liquid."""

MEDIA = {"0.49%": (2.30e-6, -0.0056), "0.59%": (5.70e-6, -0.0744), "0.83%": (16.52e-6, -0.1455)}
"""Mass of methylcellulose in buffered saline, with the constants a [Pa s^n] and beta of its power law."""

_HERE = "viscosity"
_FREEZING = 273.15  # K
_MEDIA_TEMPERATURES = 22.0, 37.0  # degrees C, in which the power law was fitted
_TEMPERATURES = 0.0, 100.0  # degrees C, in which the other formulas were
_OILS = 0.999e-4, 1.001  # m^2/s at 25 degrees C
_BEYOND = 2.0  # factor by which the shear rate may lie beyond those measured, with a wider error
_EXAMPLE = "23.0 +/- 0.5 degC"


def water_glycerol(mass_fraction: Given, temperature: Given) -> Quantity:
    """Return the viscosity of a mixture of water and glycerol with its standard error.

    The errors of mass fraction and temperature are carried through the formula to first order, and added to its own
    error `FORMULA_ERROR`.

    Parameters
    ----------
    mass_fraction : Quantity [-]
        Mass of glycerol over that of the mixture, from 0 to 1.
    temperature : Quantity
        From 0 to 100 degrees Celsius, as ``"23.0 degC"`` or ``"296.15 K"``; in degrees Celsius without a unit.

    Returns
    -------
    Quantity [Pa s]

    Raises
    ------
    InputError
        If either is no number, or lies out of the range of the formula.

    References
    ----------
    Cheng 2008, Ind. Eng. Chem. Res. 47, 3285, https://doi.org/10.1021/ie071349z.

    Examples
    --------
    >>> viscosity = water_glycerol("0.98 +/- 0.002", "23.0 +/- 0.5 degC")
    >>> f"{viscosity.value:.2f} +/- {viscosity.error:.2f} {viscosity.unit}"
    '0.71 +/- 0.05 Pa s'
    """
    share = _within(mass_fraction, "mass_fraction", (0.0, 1.0), "0.98 +/- 0.002")
    degrees = _celsius(temperature, _TEMPERATURES)
    step_share, step_degrees = 1e-5, 1e-3
    inside = min(max(share.value, step_share), 1.0 - step_share)
    by_share = _slope(cheng(inside + np.array([-1, 1]) * step_share, degrees.value), step_share)
    by_degrees = _slope(cheng(share.value, degrees.value + np.array([-1, 1]) * step_degrees), step_degrees)
    relative = math.hypot(by_share * share.error, by_degrees * degrees.error, FORMULA_ERROR)
    mean = float(cheng(share.value, degrees.value))
    return Quantity(mean, relative * mean, "Pa s")


def silicone_oil(kinematic_viscosity: Given, density: Given, temperature: Given) -> Quantity:
    """Return the viscosity of a dimethyl silicone oil with its standard error.

    Parameters
    ----------
    kinematic_viscosity : Quantity [m^2/s]
        At 25 degrees C, as its bottle states it; from 100 to 1,000,000 mm^2/s.
    density : Quantity [kg/m^3]
        At 25 degrees C.
    temperature : Quantity
        As of `water_glycerol`, from 0 to 100 degrees Celsius.

    Returns
    -------
    Quantity [Pa s]

    Raises
    ------
    InputError
        If one is no number, or lies out of the range of the formula.

    References
    ----------
    Shin-Etsu, Silicone fluid KF-96, performance test results: log10 nu = log10 nu_25 + 763.1 / (273 + t) - 2.559, and
    a density that falls by 0.095 % a degree.

    Examples
    --------
    >>> viscosity = silicone_oil("1000 +/- 20 mm^2/s", "970 +/- 2 kg/m^3", "21.0 +/- 0.5 degC")
    >>> f"{viscosity.value:.2f} +/- {viscosity.error:.2f} {viscosity.unit}"
    '1.06 +/- 0.04 Pa s'
    """
    stated = _of_unit(kinematic_viscosity, "kinematic_viscosity", "m^2/s", "1000 +/- 20 mm^2/s")
    if not _OILS[0] < stated.value < _OILS[1]:
        raise InputError(_HERE, "kinematic_viscosity", "from 100 to 1,000,000 mm^2/s", str(stated))
    mass = _of_unit(density, "density", "kg/m^3", "970 +/- 2 kg/m^3")
    degrees = _celsius(temperature, _TEMPERATURES)

    def factor(temperature: ArrayLike) -> Floats:
        t = np.asarray(temperature, dtype=float)
        return np.asarray(10.0 ** (763.1 / (273.0 + t) - 2.559) * (1.0 - 0.95e-3 * (t - 25.0)))

    step = 1e-3
    by_degrees = _slope(factor(degrees.value + np.array([-1, 1]) * step), step)
    errors = stated.error / stated.value, mass.error / mass.value, by_degrees * degrees.error, OIL_ERROR
    mean = float(stated.value * mass.value * factor(degrees.value))
    return Quantity(mean, math.hypot(*errors) * mean, "Pa s")


def methylcellulose(medium: str, temperature: Given, flow_rate: Given, half_width: Given) -> Quantity:
    """Return the viscosity of methylcellulose in saline at the shear rate of the wall of a square channel.

    At shear rates beyond `SHEAR_RATES` by up to a factor of two the error is wider by the change of the viscosity from
    the nearest of them.

    Parameters
    ----------
    medium : str
        Mass of methylcellulose, one of `MEDIA`.
    temperature : Quantity
        As of `water_glycerol`, from 22 to 37 degrees Celsius.
    flow_rate : Quantity [m^3/s]
        Of the liquid in the channel.
    half_width : Quantity [m]
        Of the channel.

    Returns
    -------
    Quantity [Pa s]

    Raises
    ------
    InputError
        If one is no number, or out of the range of the formula, or the shear rate is far beyond `SHEAR_RATES`.

    References
    ----------
    Büyükurganci et al. 2023, Soft Matter 19, 1739: mu = K rate^(n - 1), K = a exp(3379.7 K / T), n = 0.00223 T / K +
    beta. Herold 2017, arXiv:1704.00572, eq. 5.2: the rate at the wall, 8 Q / w^3 (0.6671 + 0.2121 / n).

    Examples
    --------
    >>> viscosity = methylcellulose("0.49%", "23.0 +/- 0.5 degC", "0.16 +/- 0.002 uL/s", "10.0 +/- 0.1 um")
    >>> f"{1e3 * viscosity.value:.2f} +/- {1e3 * viscosity.error:.2f} mPa s"
    '3.33 +/- 0.41 mPa s'
    """
    if medium not in MEDIA:
        raise InputError(_HERE, "medium", f"one of {', '.join(MEDIA)}", medium)
    degrees = _celsius(temperature, _MEDIA_TEMPERATURES)
    flow = _of_unit(flow_rate, "flow_rate", "m^3/s", "0.16 +/- 0.002 uL/s")
    width = _of_unit(half_width, "half_width", "m", "10.0 +/- 0.1 um")
    a, beta = MEDIA[medium]

    def law(temperature: ArrayLike) -> tuple[Floats, Floats, Floats]:
        kelvin = _FREEZING + np.asarray(temperature, dtype=float)
        index = 0.00223 * kelvin + beta
        rate = 8.0 * flow.value / (2.0 * width.value) ** 3 * (0.6671 + 0.2121 / index)
        return np.asarray(a * np.exp(3379.7 / kelvin) * rate ** (index - 1.0)), index, rate

    step, (least, most) = 1e-3, SHEAR_RATES
    mean, index, rate = (float(number) for number in law(degrees.value))
    beyond = max(least / rate, rate / most, 1.0)
    if beyond > _BEYOND:
        expected = f"a shear rate at the wall from {least / _BEYOND:g} to {most * _BEYOND:g} 1/s"
        advice = "measure the viscosity at this shear rate"
        raise InputError(_HERE, "flow_rate, half_width", expected, f"{rate:.3g} 1/s", advice)
    by_degrees = _slope(law(degrees.value + np.array([-1, 1]) * step)[0], step)
    by_rate = index - 1.0
    of_rate = by_rate * flow.error / flow.value, 3.0 * by_rate * width.error / width.value
    errors = *of_rate, by_degrees * degrees.error, MEDIUM_ERROR, by_rate * math.log(beyond)
    return Quantity(mean, math.hypot(*errors) * mean, "Pa s")


def cheng(mass_fraction: ArrayLike, temperature: ArrayLike) -> Floats:
    """Return the viscosity of water with a mass fraction of glycerol at temperatures in degrees C [Pa s].

    Examples
    --------
    >>> cheng(mass_fraction=[0.0, 1.0], temperature=20.0).round(4)
    array([1.0000e-03, 1.4138e+00])
    """
    share, degrees = np.asarray(mass_fraction, dtype=float), np.asarray(temperature, dtype=float)
    water = 1.790e-3 * np.exp((-1230.0 - degrees) * degrees / (36100.0 + 360.0 * degrees))
    glycerol = 12.100 * np.exp((-1233.0 + degrees) * degrees / (9900.0 + 70.0 * degrees))
    a = 0.705 - 0.0017 * degrees
    b = (4.9 + 0.036 * degrees) * a**2.5
    weight = 1.0 - share + a * b * share * (1.0 - share) / (a * share + b * (1.0 - share))
    return np.asarray(water**weight * glycerol ** (1.0 - weight))


def _slope(pair: Floats, step: float) -> float:
    """Return the derivative of the logarithm from two values at two steps from each other."""
    return float(np.log(pair[1] / pair[0]) / (2.0 * step))


def _of_unit(given: Given, key: str, unit: str, example: str) -> Quantity:
    """Return a positive number with a unit, and its error."""
    made = _read(given, key, (unit,), example)
    if not (made.shape == "normal" and made.value > 0.0):
        raise InputError(_HERE, key, f'a number with its error and unit, as "{example}"', str(made))
    return made


def _celsius(given: Given, limits: tuple[float, float]) -> Quantity:
    """Return a temperature in degrees Celsius within limits, with its error."""
    made = _read(given, "temperature", ("", "K"), _EXAMPLE, signed=True)
    if made.unit:
        made = replace(made.rescaled(round(made.value - _FREEZING, 9)), unit="")
    return _within(made, "temperature", limits, _EXAMPLE)


def _within(given: Given, key: str, limits: tuple[float, float], example: str) -> Quantity:
    """Return a number within limits, with its error."""
    made, (least, most) = _read(given, key, ("",), example, signed=True), limits
    if not (made.shape == "normal" and least <= made.value <= most):
        raise InputError(_HERE, key, f'a number from {least:g} to {most:g} with its error, as "{example}"', str(made))
    return made


def _read(given: Given, key: str, units: tuple[str, ...], example: str, *, signed: bool = False) -> Quantity:
    if isinstance(given, str):
        given = Quantity.read(given, where=_HERE, key=key, units=units, example=example, signed=signed)
    return Quantity.of(given, key, where=_HERE, units=units, signed=signed)
