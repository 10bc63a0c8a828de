"""Numbers as people read them: rounded by their error, in the unit of the quantity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from capsbayes.parameters import PARAMETERS, Parameter

if TYPE_CHECKING:
    from capsbayes.infer import Marginal


def decimals(error: float) -> int:
    """Return the decimals to print, negative for tens: two digits of the error up to 35, one above; 3 without one."""
    # This is the rule of the Particle Data Group. `uncertainties` follows it too, but neither for the ends of an
    # interval together with its median nor for tens and hundreds without an exponent.
    if not (math.isfinite(error) and error > 0.0):
        return 3
    power = math.floor(math.log10(error))
    return (1 if error / 10.0**power < 3.55 else 0) - power


def two_digits(error: float) -> int:
    """Return the decimals that show two digits of an error, as tables do; 3 without an error."""
    return max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 3


def rounded(value: float, digits: int) -> str:
    """Return a number with so many decimals; "not known" for NaN."""
    return f"{round(value, digits):z.{max(digits, 0)}f}" if math.isfinite(value) else "not known"


def together(values: Sequence[float], digits: int) -> list[str]:
    """Return a median and the ends of its interval with so many decimals, or each with two digits of its own."""
    # The latter where less than two digits of one of several positive numbers would be left: the lower end of a long
    # tail is not rounded to zero.
    if min(values) > 0.0 and min(values) < 10.0 ** (1 - digits):
        return [rounded(value, 1 - math.floor(math.log10(value))) for value in values]
    return [rounded(value, digits) for value in values]


def counted(number: int, noun: str, one: str = "", several: str = "") -> str:
    """Return a number with its noun, and perhaps a verb: "1 capsule was", "2 capsules were"."""
    return f"{number} {noun} {one}".rstrip() if number == 1 else f"{number} {noun}s {several}".rstrip()


def unit_of(parameter: Parameter) -> str:
    """Return the display unit after a number, with a space before it; empty for a ratio."""
    return "" if parameter.shown_unit in ("", "-") else f" {parameter.shown_unit}"


def with_unit(name: str, value: float, digits: str = ".3g") -> str:
    """Return a number, given in SI, with the display unit; empty if it is not finite."""
    parameter = PARAMETERS[name]
    return f"{parameter.shown(value):{digits}}{unit_of(parameter)}" if math.isfinite(value) else ""


def stated_in(name: str, unit: str) -> tuple[float, str]:
    """Return factor and display unit of a quantity stated in a unit: a length may be over l or in metres."""
    return {"l": (1.0, " l"), "m": (1e6, " µm")}.get(unit, (PARAMETERS[name].scale, unit_of(PARAMETERS[name])))


def value_words(name: str, marginal: Marginal) -> str:
    """Return a median with its 95 % interval, as in a heading."""
    parameter = PARAMETERS[name]
    digits = decimals(parameter.shown(0.5 * (marginal.upper_68 - marginal.lower_68)))
    numbers = [parameter.shown(value) for value in (marginal.median, marginal.lower_95, marginal.upper_95)]
    middle, low, high = together(numbers, digits)
    return f"{parameter.symbol} = {middle}{unit_of(parameter)}, 95 % [{low}, {high}]"


def interval_words(name: str, low: float, high: float, digits: int) -> str:
    """Return two ends, given in SI, in the display unit."""
    return " to ".join(together([PARAMETERS[name].shown(end) for end in (low, high)], digits))


def per_cent(share: float) -> str:
    """Return a share in per cent: two digits of it below ten."""
    value = 100.0 * share
    return f"{value:.0f} %" if abs(value) >= 9.95 or value == 0.0 else f"{float(np.round(value, 1)):g} %"


def marginal_cells(name: str, marginal: Marginal) -> list[str]:
    """Return median, 68 and 95 % interval in the display unit, with two digits of the standard deviation."""
    parameter = PARAMETERS[name]
    digits = two_digits(parameter.shown(marginal.sd))
    ends = [interval_words(name, *marginal.ends(level), digits) for level in (68, 95)]
    return [rounded(parameter.shown(marginal.median), digits), *ends]
