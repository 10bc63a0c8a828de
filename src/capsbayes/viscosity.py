"""Viscosity of a suspending liquid from what it was mixed of: with its error, and where it comes from."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.quantity import Given, Quantity

FORMULA_ERROR = 0.04
"""Relative standard error of the formula of `water_glycerol` itself."""

SOURCE = "Cheng 2008, https://doi.org/10.1021/ie071349z"

_WARMEST = 100.0  # degrees C, to which the formula was fitted


def water_glycerol(mass_fraction: Given, temperature: Given) -> Quantity:
    """Return the viscosity of a mixture of water and glycerol with its standard error.

    The errors of mass fraction and temperature are carried through the formula to first order, and added to its own
    error `FORMULA_ERROR`.

    Parameters
    ----------
    mass_fraction : Quantity [-]
        Mass of glycerol over that of the mixture, from 0 to 1.
    temperature : Quantity [C]
        In degrees Celsius, without a unit, from 0 to 100.

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
    >>> viscosity = water_glycerol("0.98 +/- 0.002", "23.0 +/- 0.5")
    >>> f"{viscosity.value:.3f} +/- {viscosity.error:.3f} {viscosity.unit}"
    '0.711 +/- 0.050 Pa s'
    """
    share = _within(mass_fraction, "mass_fraction", 1.0, "0.98 +/- 0.002")
    degrees = _within(temperature, "temperature", _WARMEST, "23.0 +/- 0.5")
    step_share, step_degrees = 1e-5, 1e-3
    inside = min(max(share.value, step_share), 1.0 - step_share)
    by_share = _slope(cheng(inside + np.array([-1, 1]) * step_share, degrees.value), step_share)
    by_degrees = _slope(cheng(share.value, degrees.value + np.array([-1, 1]) * step_degrees), step_degrees)
    relative = math.hypot(by_share * share.error, by_degrees * degrees.error, FORMULA_ERROR)
    mean = float(cheng(share.value, degrees.value))
    return Quantity(mean, relative * mean, "Pa s")


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


def _within(given: Given, key: str, most: float, example: str) -> Quantity:
    """Return a number from 0 to `most`, with its error."""
    where = "viscosity"
    if isinstance(given, str):
        given = Quantity.read(given, where=where, key=key, units=("",), example=example, signed=True)
    made = Quantity.of(given, where=where, key=key, units=("",), signed=True)
    if not (made.shape == "normal" and 0.0 <= made.value <= most):
        raise InputError(where, key, f'a number from 0 to {most:g} with its error, as "{example}"', str(made))
    return made
