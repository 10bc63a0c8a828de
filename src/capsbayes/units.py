"""Numbers with units in text: ``"50.0 +/- 0.5 um"`` is split and converted to SI, and nothing is evaluated."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from decimal import Decimal
from typing import Any, NamedTuple

from capsbayes.errors import InputError

# The whole registry of pint takes a fifth of a second more to build, and knows units that nobody means here: "a" would
# be a year, and "l", which is the half width of the channel, a litre.
_UNITS = """
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
deci- = 1e-1 = d-
kilo- = 1e3 = k-
mega- = 1e6 = M-
meter = [length] = m = metre
micron = micrometer
liter = 1e-3 * meter ** 3 = L = litre
gram = [mass] = g
second = [time] = s = sec
minute = 60 * second = min
hour = 60 * minute = h
hertz = 1 / second = Hz
newton = kilogram * meter / second ** 2 = N
dyne = 1e-5 * newton = dyn
pascal = newton / meter ** 2 = Pa
poise = 0.1 * pascal * second = P
percent = 0.01 = %
"""

# Nothing of a text is evaluated: numbers are matched by these patterns, and a unit is names with one-digit powers.
_NUMBER = r"[-+]?(?:(?:\d+(?:\.(?!\.)\d*)?|\.\d+)(?:[eE][-+]?\d+)?|nan|inf)"
_TEXT = re.compile(
    rf"(?:(?P<shape>log-uniform|log-normal)\s+)?(?P<first>{_NUMBER})"
    rf"(?:\s*(?P<between>\+/-|±|\.\.)\s*(?P<second>{_NUMBER})|\((?P<digits>\d+)\))?\s*(?P<unit>.*)"
)
_PARENTHESES = re.compile(r"\(([^()]*)\)(.*)")
_FACTOR = re.compile(r"\s*(?P<sign>[*·/]?)\s*(?P<name>[A-Za-zµμ]+|%)\s*(?:(?:\^|\*\*)\s*(?P<power>[-+]?\d))?")


class ParsedText(NamedTuple):
    """Numbers of a text, in SI.

    Parameters
    ----------
    first, second : float
        The number and its error (zero if there is none), or two limits.
    unit : str
        SI unit.
    is_range : bool
        True for two limits.
    shape : str
        The word before the numbers, log-uniform or log-normal; empty if there is none.
    """

    first: float
    second: float
    unit: str
    is_range: bool
    shape: str


def parsed(text: str, units: Sequence[str], *, where: str, key: str, wanted: str) -> ParsedText:
    """Split a text into its numbers and its unit, and convert the numbers to SI.

    Parameters
    ----------
    text : str
    units : sequence of str
        SI units allowed, one for each dimension; an empty string allows a bare number.
    where, key, wanted : str
        File, key, and what would have been right, for the message of an error.

    Raises
    ------
    InputError
        If the text cannot be parsed, or its unit is unknown or of another dimension.
    """
    text = text.strip()
    found = _TEXT.fullmatch(_PARENTHESES.sub(r"\1 \2", text) if text.startswith("(") else text)
    if found is None:
        raise InputError(where, key, wanted, repr(text))
    numbers = float(found["first"]), float(found["second"] or 0.0)
    if found["digits"]:  # 50.0(5) is 50.0 +/- 0.5
        numbers = numbers[0], float(found["digits"]) * 10.0 ** int(Decimal(found["first"]).as_tuple().exponent)
    unit, numbers = _converted(numbers, found["unit"], units, text, where, key, wanted)
    return ParsedText(*numbers, unit, found["between"] == "..", found["shape"] or "")


@functools.cache
def _registry() -> Any:
    """Return the registry of the units an experiment needs, built when a unit is first read."""
    import pint

    registry: Any = pint.UnitRegistry(None)
    registry.load_definitions(_UNITS.splitlines())
    return registry


def _unit(text: str) -> Any:
    """Return the pint unit of a text: names with powers, multiplied or divided; None if the text cannot be parsed."""
    rest, inverse = re.subn(r"^1\s*(?=/)", "", text.strip())
    unit, place, allowed = _registry().dimensionless, 0, "/" if inverse else ""
    while place < len(rest):
        found = _FACTOR.match(rest, place)
        if found is None or (place == 0 and found["sign"] != allowed):
            return None
        power = int(found["power"] or 1)
        unit = unit * _registry().Unit(found["name"]) ** (-power if found["sign"] == "/" else power)
        place = found.end()
    return unit


def _converted(
    numbers: tuple[float, float], unit: str, units: Sequence[str], text: str, where: str, key: str, wanted: str
) -> tuple[str, tuple[float, float]]:
    """Return the first of the SI units that fits, and the numbers in it."""
    if not unit:
        if "" not in units:
            raise InputError(where, key, wanted, f"no unit in {text!r}")
        return "", numbers
    import pint

    try:
        stated = _unit(unit)
    except pint.UndefinedUnitError:
        raise InputError(where, key, wanted, f"an unknown unit in {text!r}") from None
    if stated is None:
        raise InputError(where, key, wanted, repr(text))
    for target in units:
        if target and stated.dimensionality == _registry().Unit(target).dimensionality:
            first, second = (float(_registry().Quantity(number, stated).to(target).magnitude) for number in numbers)
            return target, (first, second)
    raise InputError(where, key, wanted, f"{stated} in {text!r}")
