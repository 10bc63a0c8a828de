"""Numbers with units in text: ``"50.0 +/- 0.5 um"`` is split and converted to SI, and nothing is evaluated."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

from capsbayes.errors import InputError

# A table of its own, as a library of all units takes half a second to import, and knows some that nobody means here:
# "a" would be a year, and "l", which is the half width of the channel, a litre.
_PREFIXES = {
    **dict.fromkeys(("nano", "n"), Fraction(1, 10**9)),
    **dict.fromkeys(("micro", "µ", "μ", "u"), Fraction(1, 10**6)),
    **dict.fromkeys(("milli", "m"), Fraction(1, 10**3)),
    **dict.fromkeys(("centi", "c"), Fraction(1, 100)),
    **dict.fromkeys(("deci", "d"), Fraction(1, 10)),
    **dict.fromkeys(("kilo", "k"), Fraction(10**3)),
    **dict.fromkeys(("mega", "M"), Fraction(10**6)),
}


class Unit(NamedTuple):
    """Unit over that of SI.

    Parameters
    ----------
    size : Fraction
    length, mass, time : int
        Powers.
    """

    size: Fraction
    length: int = 0
    mass: int = 0
    time: int = 0

    def times(self, other: Unit, power: int) -> Unit:
        """Return the product with a power of another unit."""
        powers = (mine + power * its for mine, its in zip(self[1:], other[1:], strict=True))
        return Unit(self.size * other.size**power, *powers)

    def measured(self, number: float) -> float:
        """Return a number of this unit in SI, the nearest one to what its shortest decimal says."""
        return float(Fraction(repr(number)) * self.size) if math.isfinite(number) else number


_UNITS = {
    **dict.fromkeys(("m", "meter", "metre"), Unit(Fraction(1), 1)),
    **dict.fromkeys(("micron", "microns"), Unit(Fraction(1, 10**6), 1)),
    **dict.fromkeys(("L", "liter", "litre"), Unit(Fraction(1, 10**3), 3)),
    **dict.fromkeys(("g", "gram"), Unit(Fraction(1, 10**3), 0, 1)),
    **dict.fromkeys(("s", "sec", "secs", "second"), Unit(Fraction(1), 0, 0, 1)),
    **dict.fromkeys(("min", "mins", "minute"), Unit(Fraction(60), 0, 0, 1)),
    **dict.fromkeys(("h", "hour"), Unit(Fraction(3600), 0, 0, 1)),
    **dict.fromkeys(("Hz", "hertz"), Unit(Fraction(1), 0, 0, -1)),
    **dict.fromkeys(("N", "newton"), Unit(Fraction(1), 1, 1, -2)),
    **dict.fromkeys(("dyn", "dyne"), Unit(Fraction(1, 10**5), 1, 1, -2)),
    **dict.fromkeys(("Pa", "pascal"), Unit(Fraction(1), -1, 1, -2)),
    **dict.fromkeys(("P", "poise"), Unit(Fraction(1, 10), -1, 1, -1)),
    **dict.fromkeys(("%", "percent"), Unit(Fraction(1, 100))),
}

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


def _named(name: str) -> Unit | None:
    """Return the unit of a name, which may have a prefix and, if it is spelled out, an s; None if it is unknown."""
    for tried in (name, name.removesuffix("s")) if len(name) > 4 else (name,):
        if tried in _UNITS:
            return _UNITS[tried]
        for prefix, size in _PREFIXES.items():
            unit = _UNITS.get(tried.removeprefix(prefix)) if tried.startswith(prefix) else None
            if unit is not None:
                return unit._replace(size=size * unit.size)
    return None


def _unit(text: str) -> Unit | str | None:
    """Return the unit of a text: names with powers, multiplied or divided.

    A name that is unknown is returned itself; None if the text cannot be parsed.
    """
    rest, inverse = re.subn(r"^1\s*(?=/)", "", text.strip())
    unit, place, allowed = Unit(Fraction(1)), 0, "/" if inverse else ""
    while place < len(rest):
        found = _FACTOR.match(rest, place)
        if found is None or (place == 0 and found["sign"] != allowed):
            return None
        power, factor = int(found["power"] or 1), _named(found["name"])
        if factor is None:
            return found["name"]
        unit = unit.times(factor, -power if found["sign"] == "/" else power)
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
    stated = _unit(unit)
    if isinstance(stated, str):
        raise InputError(where, key, wanted, f"an unknown unit in {text!r}")
    for target in filter(None, units):
        into = _unit(target)
        if isinstance(stated, Unit) and isinstance(into, Unit) and stated[1:] == into[1:]:
            into_target = stated.times(into, -1)
            return target, (into_target.measured(numbers[0]), into_target.measured(numbers[1]))
    raise InputError(where, key, wanted, repr(text))
