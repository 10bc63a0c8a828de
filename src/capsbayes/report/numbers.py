"""Numbers as people read them: rounded by their error, in the unit of the quantity.

`uncertainties` rounds a value with its error by the same rule, but neither the ends of an interval together with its
median nor tens and hundreds without an exponent, so the rule stands here."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from capsbayes.infer import Marginal
from capsbayes.parameters import PARAMETERS, Parameter


def decimals(error: float) -> int:
    """Return the number of decimals to print: two significant digits of the error up to 35, one above.

    This is the rule of the Particle Data Group. Negative where tens or hundreds are rounded off; 3 without an error.

    Examples
    --------
    >>> decimals(5.9), decimals(0.29), decimals(0.0081), decimals(241.0), decimals(0.0)
    (0, 2, 3, -1, 3)
    """
    if not (math.isfinite(error) and error > 0.0):
        return 3
    power = math.floor(math.log10(error))
    return (1 if error / 10.0**power < 3.55 else 0) - power


def two_digits(error: float) -> int:
    """Return the decimals that show two digits of an error, as tables do; 3 without an error."""
    return max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 3


def rounded(value: float, digits: int) -> str:
    """Return a number with so many decimals; "not known" for NaN.

    Examples
    --------
    >>> rounded(0.08106, 3), rounded(5128.0, -2)
    ('0.081', '5100')
    """
    return f"{round(value, digits):.{max(digits, 0)}f}" if math.isfinite(value) else "not known"


def together(values: Sequence[float], digits: int) -> list[str]:
    """Return numbers of one quantity with so many decimals, as a median and the ends of its interval.

    Where that would leave less than two digits of one of several positive numbers, each has two digits of its own:
    the lower end of a long tail is not rounded to zero.

    Examples
    --------
    >>> together((50.03, 40.5, 63.7), 0), together((296.0, 31.4, 1412.0), -2)
    (['50', '40', '64'], ['300', '31', '1400'])
    """
    if min(values) > 0.0 and min(values) < 10.0 ** (1 - digits):
        return [rounded(value, 1 - math.floor(math.log10(value))) for value in values]
    return [rounded(value, digits) for value in values]


def unit_of(parameter: Parameter) -> str:
    """Return the display unit after a number, with a space before it; empty for a ratio."""
    return "" if parameter.shown_unit in ("", "-") else f" {parameter.shown_unit}"


def with_unit(name: str, value: float, digits: str = ".3g") -> str:
    """Return a number, given in SI, with the display unit; empty if it is not finite.

    Examples
    --------
    >>> with_unit("capsule_radius", 23.4e-6)
    '23.4 µm'
    """
    parameter = PARAMETERS[name]
    return f"{parameter.shown(value):{digits}}{unit_of(parameter)}" if math.isfinite(value) else ""


def stated_in(name: str, unit: str) -> tuple[float, str]:
    """Return factor and display unit of a quantity stated in a unit: a length may be over l or in metres.

    Examples
    --------
    >>> stated_in("axial_extent", "l"), stated_in("half_width", "m")[1]
    ((1.0, ' l'), ' µm')
    """
    return {"l": (1.0, " l"), "m": (1e6, " µm")}.get(unit, (PARAMETERS[name].scale, unit_of(PARAMETERS[name])))


def value_words(name: str, marginal: Marginal) -> str:
    """Return a median with its 95 % interval, as in a heading.

    Examples
    --------
    >>> value_words("surface_shear_modulus", Marginal(0.071, 0.004, 0.071, 0.067, 0.075, 0.0638, 0.0792))
    'G_s = 71 mN/m, 95 % [64, 79]'
    """
    parameter = PARAMETERS[name]
    digits = decimals(parameter.shown(0.5 * (marginal.upper_68 - marginal.lower_68)))
    numbers = [parameter.shown(value) for value in (marginal.median, marginal.lower_95, marginal.upper_95)]
    middle, low, high = together(numbers, digits)
    return f"{parameter.symbol} = {middle}{unit_of(parameter)}, 95 % [{low}, {high}]"


def interval_words(name: str, low: float, high: float, digits: int) -> str:
    """Return two ends, given in SI, in the display unit.

    Examples
    --------
    >>> interval_words("capsule_radius", 23.4e-6, 24.54e-6, 1)
    '23.4 to 24.5'
    """
    return " to ".join(together([PARAMETERS[name].shown(end) for end in (low, high)], digits))


def per_cent(share: float) -> str:
    """Return a share in per cent: two digits of it below ten.

    Examples
    --------
    >>> per_cent(0.603), per_cent(0.0421), per_cent(0.0)
    ('60 %', '4.2 %', '0 %')
    """
    value = 100.0 * share
    return f"{value:.0f} %" if abs(value) >= 9.95 or value == 0.0 else f"{float(np.round(value, 1)):g} %"
