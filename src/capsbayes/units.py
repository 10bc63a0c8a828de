"""Numbers with units in text: ``"50.0 +/- 0.5 um"`` is split and converted to SI, and nothing is evaluated."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Sequence
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

from capsbayes.errors import InputError

LARGEST = 1e60
"""Number in SI that can be read, and the inverse of the smallest: squares and products of them are numbers too."""

# A table of its own, as a library of all units takes half a second to import, and knows some that nobody means here:
# "a" would be a year, and "l", which is the half width of the channel, a litre.
_PREFIXES = {
    **dict.fromkeys(("nano", "n"), Fraction(1, 10**9)),
    **dict.fromkeys(("micro", "μ", "u"), Fraction(1, 10**6)),
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
    length, mass, time, temperature : int
        Powers.
    zero : Fraction
        Its zero in SI, as that of degrees Celsius.
    """

    size: Fraction
    length: int = 0
    mass: int = 0
    time: int = 0
    temperature: int = 0
    zero: Fraction = Fraction(0)

    @property
    def dimension(self) -> tuple[int, ...]:
        """Powers of the units of SI."""
        return self[1:5]

    def times(self, other: Unit, power: int) -> Unit:
        """Return the product with a power of another unit."""
        length, mass, time, temperature = (
            mine + power * its for mine, its in zip(self.dimension, other.dimension, strict=True)
        )
        return Unit(self.size * other.size**power, length, mass, time, temperature)

    def measured(self, number: float) -> float:
        """Return a number of this unit in SI, the nearest one to what its shortest decimal says."""
        try:
            return float(Fraction(repr(number)) * self.size + self.zero) if math.isfinite(number) else number
        except OverflowError:
            return math.inf


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
    **dict.fromkeys(("St", "stokes"), Unit(Fraction(1, 10**4), 2, 0, -1)),
    **dict.fromkeys(("K", "kelvin"), Unit(Fraction(1), 0, 0, 0, 1)),
}
_CELSIUS = dict.fromkeys(("degC", "°C", "C", "celsius"), Unit(Fraction(1), 0, 0, 0, 1, Fraction(27315, 100)))
_KINEMATIC = (2, 0, -1, 0)  # powers of m^2/s

# Nothing of a text is evaluated: numbers are matched by these patterns, and a unit is names with one-digit powers.
_LONGEST = 200
_NUMBER = r"[-+]?(?:(?:[0-9]+(?:\.(?!\.)[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|nan|inf)"
_TEXT = re.compile(
    rf"(?:(?P<shape>log-uniform|log-normal)\s+)?(?P<first>{_NUMBER})(?:\((?P<digits>[0-9]+)\))?\s*(?P<unit>.*?)"
    rf"(?:\s*(?P<between>±|\.\.(?!\.))\s*(?P<second>{_NUMBER})\s*(?P<percent>%?)\s*(?P<last>.*))?"
)
_PARENTHESES = re.compile(r"(?P<shape>log-\w+\s+|)\((?P<numbers>[^()A-DF-Za-df-z]*|nan|inf)\)(?P<unit>.*)")
_FACTOR = re.compile(r"\s*(?P<sign>[*·⋅./]?)\s*(?P<name>[A-Za-zμ]+)\s*(?:(?:\^|\*\*)\s*(?P<power>[-+]?[0-9]))?")
_SUPERSCRIPT = re.compile(r"[⁺⁻]?[⁰¹²³⁴-⁹]+")

_BY_NAME = (
    (
        re.compile(r"[0-9](?=.*(?<![eE^*])\+[\s{]*[0-9.])(?=.*(?<![eE^*])-[\s{]*[0-9.])"),
        "an asymmetric error",
        "write the larger of the two after +/-, or a range low .. high",
    ),
    (re.compile(r"[0-9],[0-9]"), "a decimal comma", "write a decimal point, and no separator of thousands"),
    (re.compile(r"[×x✕*·⋅]\s*10(?![0-9])"), "a power of ten", "write 2.5e-5 for 2.5 times 10^-5"),
)
_OF_PER_CENT = 'write % after an error only, as in "6.20 +/- 1% mm/s", and a ratio as a number, 0.02 for 2 %'


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
    """Split a text into its numbers and their units, and convert the numbers to SI.

    The page on conventions says what can be written, under "How a quantity is written".

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
        If the text cannot be parsed, or its units are unknown or of another dimension.
    """
    stated = repr(text if len(text) <= _LONGEST else f"{text[:40]} ...")

    def refused(found: str = "", advice: str = "") -> InputError:
        return InputError(where, key, wanted, f"{found} in {stated}" if found else stated, advice)

    plain = _plain(text[: _LONGEST + 1])
    for pattern, name, advice in _BY_NAME:
        if pattern.search(plain):
            raise refused(name, advice)
    inside = _PARENTHESES.fullmatch(plain)
    found = _TEXT.fullmatch("{shape}{numbers} {unit}".format(**inside.groupdict()).strip() if inside else plain)
    if found is None or len(text) > _LONGEST:
        raise refused()
    is_range, percent, last = found["between"] == "..", bool(found["percent"]), found["last"] or ""
    of_first = found["unit"] or last
    if "%" in of_first + last or (percent and (is_range or not of_first or (found["unit"] and last))):
        raise refused("a per cent", _OF_PER_CENT)
    target, scale = _resolved(of_first, units, refused)
    number = float(found["first"])
    if found["digits"]:  # 50.0(5) is 50.0 +/- 0.5
        if found["between"] or not math.isfinite(number):
            raise refused()
        second = float(f"{found['digits']}e{Decimal(found['first']).as_tuple().exponent}")
    else:
        second = float(found["second"] or 0.0)
    other = scale
    if percent:
        if number == 0.0 or scale.zero:
            raise refused("a per cent of a number that may be zero", _OF_PER_CENT)
        second = abs(number) * second / 100.0
    elif found["second"] and of_first:
        if not last:
            raise refused(f"no unit after {found['second']}")
        its, other = _resolved(last, units, refused)
        if its != target:
            raise refused("two kinds of units")
    if not is_range:
        other = other._replace(zero=Fraction(0))
    return ParsedText(scale.measured(number), other.measured(second), target, is_range, found["shape"] or "")


def _plain(text: str) -> str:
    """Return a text with one spelling of blanks, signs, powers and units."""
    text = _SUPERSCRIPT.sub(lambda found: f"^{found[0]}", text)
    text = unicodedata.normalize("NFKC", text).replace("−", "-")
    text = re.sub(r"\+\s?/\s?-|\+-", "±", text)
    return re.sub(r"\bper ?cent\b", "%", re.sub(r"(?:°|\bdeg)\s+C\b", "°C", text)).strip()


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
    if text.strip() in _CELSIUS:
        return _CELSIUS[text.strip()]
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


def _resolved(text: str, units: Sequence[str], refused: Callable[..., InputError]) -> tuple[str, Unit]:
    """Return the first of the SI units that fits the unit of a text, and the latter over it."""
    if not text:
        if "" not in units:
            raise refused("no unit")
        return "", Unit(Fraction(1))
    stated = _unit(text)
    if isinstance(stated, str):
        raise refused("an unknown unit")
    for target in filter(None, units):
        into = _unit(target)
        if isinstance(stated, Unit) and isinstance(into, Unit) and stated.dimension == into.dimension:
            return target, stated._replace(size=stated.size / into.size)
    if isinstance(stated, Unit) and stated.dimension == _KINEMATIC and "Pa s" in units:
        raise refused("a kinematic viscosity", "multiply it by the density of the liquid")
    raise refused()
