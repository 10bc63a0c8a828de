"""Quantities: a value with its error or distribution, and its unit, as people write them."""

from __future__ import annotations

import math
import numbers
import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.parameters import BELIEVED, PARAMETERS, SI_UNITS, STATED


def settle(frozen: object, **values: Any) -> None:
    """Replace what was given to a frozen object by what it means, while it is made."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


# Numbers with units in text: ``"50.0 +/- 0.5 um"`` is split and converted to SI, and nothing is evaluated

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
    """Unit over that of SI."""

    size: Fraction
    dimension: tuple[int, ...] = (0, 0, 0, 0)  # powers of length, mass, time and temperature
    zero: Fraction = Fraction(0)  # in SI, as that of degrees Celsius

    def times(self, other: Unit, power: int) -> Unit:
        """Return the product with a power of another unit."""
        powers = (mine + power * its for mine, its in zip(self.dimension, other.dimension, strict=True))
        return Unit(self.size * other.size**power, tuple(powers))

    def measured(self, number: float) -> float:
        """Return a number of this unit in SI, the nearest one to what its shortest decimal says."""
        try:
            return float(Fraction(repr(number)) * self.size + self.zero) if math.isfinite(number) else number
        except OverflowError:
            return math.inf


_UNITS = {
    **dict.fromkeys(("m", "meter", "metre"), Unit(Fraction(1), (1, 0, 0, 0))),
    **dict.fromkeys(("micron", "microns"), Unit(Fraction(1, 10**6), (1, 0, 0, 0))),
    **dict.fromkeys(("L", "liter", "litre"), Unit(Fraction(1, 10**3), (3, 0, 0, 0))),
    **dict.fromkeys(("g", "gram"), Unit(Fraction(1, 10**3), (0, 1, 0, 0))),
    **dict.fromkeys(("s", "sec", "secs", "second"), Unit(Fraction(1), (0, 0, 1, 0))),
    **dict.fromkeys(("min", "mins", "minute"), Unit(Fraction(60), (0, 0, 1, 0))),
    **dict.fromkeys(("h", "hour"), Unit(Fraction(3600), (0, 0, 1, 0))),
    **dict.fromkeys(("Hz", "hertz"), Unit(Fraction(1), (0, 0, -1, 0))),
    **dict.fromkeys(("N", "newton"), Unit(Fraction(1), (1, 1, -2, 0))),
    **dict.fromkeys(("dyn", "dyne"), Unit(Fraction(1, 10**5), (1, 1, -2, 0))),
    **dict.fromkeys(("Pa", "pascal"), Unit(Fraction(1), (-1, 1, -2, 0))),
    **dict.fromkeys(("P", "poise"), Unit(Fraction(1, 10), (-1, 1, -1, 0))),
    **dict.fromkeys(("St", "stokes"), Unit(Fraction(1, 10**4), (2, 0, -1, 0))),
    **dict.fromkeys(("K", "kelvin"), Unit(Fraction(1), (0, 0, 0, 1))),
}
_CELSIUS = dict.fromkeys(("degC", "°C", "C", "celsius"), Unit(Fraction(1), (0, 0, 0, 1), Fraction(27315, 100)))
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
    """Numbers of a text, in SI."""

    first: float
    second: float  # the error, zero if there is none; or the second limit
    unit: str  # of SI
    is_range: bool
    shape: str  # the word before the numbers, log-uniform or log-normal; empty if there is none


def parsed(text: str, units: Sequence[str], *, where: str, key: str, wanted: str) -> ParsedText:
    """Split a text into its numbers, in the SI unit that fits, of which an empty one allows a bare number."""
    # The page on conventions says what can be written, under "How a quantity is written".
    stated = repr(text if len(text) <= _LONGEST else f"{text[:40]} ...")

    def refused(mistake: str = "", advice: str = "") -> InputError:
        return InputError(where, key, wanted, f"{mistake} in {stated}" if mistake else stated, advice)

    plain = _plain(text[: _LONGEST + 1])
    if mistake := mistake_in(plain):
        raise refused(*mistake)
    inside = _PARENTHESES.fullmatch(plain)
    parts = _TEXT.fullmatch("{shape}{numbers} {unit}".format(**inside.groupdict()).strip() if inside else plain)
    if parts is None or len(text) > _LONGEST:
        raise refused()
    is_range, percent, last = parts["between"] == "..", bool(parts["percent"]), parts["last"] or ""
    of_first = parts["unit"] or last
    if "%" in of_first + last or (percent and (is_range or not of_first or (parts["unit"] and last))):
        raise refused("a per cent", _OF_PER_CENT)
    target, scale = _resolved(of_first, units, refused)
    number = float(parts["first"])
    if parts["digits"]:  # 50.0(5) is 50.0 +/- 0.5
        if parts["between"] or not math.isfinite(number):
            raise refused()
        second = float(f"{parts['digits']}e{Decimal(parts['first']).as_tuple().exponent}")
    else:
        second = float(parts["second"] or 0.0)
    other = scale
    if percent:
        if number == 0.0 or scale.zero:
            raise refused("a per cent of a number that may be zero", _OF_PER_CENT)
        second = abs(number) * second / 100.0
    elif parts["second"] and of_first:
        if not last:
            raise refused(f"no unit after {parts['second']}")
        unit, other = _resolved(last, units, refused)
        if unit != target:
            raise refused("two kinds of units")
    if not is_range:
        other = other._replace(zero=Fraction(0))
    return ParsedText(scale.measured(number), other.measured(second), target, is_range, parts["shape"] or "")


def mistake_in(text: str) -> tuple[str, str] | None:
    """Return the name of a usual mistake in a text, as a decimal comma, and what to do; None if there is none."""
    plain = _plain(text)
    return next(((name, advice) for pattern, name, advice in _BY_NAME if pattern.search(plain)), None)


def _plain(text: str) -> str:
    """Return a text with one spelling of blanks, signs, powers and units."""
    text = _SUPERSCRIPT.sub(lambda power: f"^{power[0]}", text)
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
    """Return the unit of names with powers, multiplied or divided; a name that is unknown; None of any other text."""
    if text.strip() in _CELSIUS:
        return _CELSIUS[text.strip()]
    rest, inverse = re.subn(r"^1\s*(?=/)", "", text.strip())
    unit, place, allowed = Unit(Fraction(1)), 0, "/" if inverse else ""
    while place < len(rest):
        part = _FACTOR.match(rest, place)
        if part is None or (place == 0 and part["sign"] != allowed):
            return None
        power, factor = int(part["power"] or 1), _named(part["name"])
        if factor is None:
            return part["name"]
        unit = unit.times(factor, -power if part["sign"] == "/" else power)
        place = part.end()
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


# One uncertain number: known, normal, uniform, log-uniform or of any distribution, with its unit and its text form

Given = Any
"""Any form that `Quantity.of` reads: a Quantity, a text, a number in SI, a pint quantity, a frozen distribution."""

_NEGATIVE_SHARE = 1e-6  # of a distribution's mass that may lie below zero before it is refused
_FAR = 10.0  # standard deviations beyond which a cut changes neither mean nor deviation
_LOG_NORMAL = 1e-6, 1e3  # error over mean of a log-normal quantity, least and most


@dataclass(frozen=True, repr=False)
class Quantity:
    """A number that may be uncertain.

    ``Quantity(0.85)`` is known; ``Quantity(0.85, 0.02, "Pa s")`` is a normal distribution cut at zero; `uniform`,
    `log_uniform` and `of` make the others.

    Parameters
    ----------
    value : float
        The number if it is known, the centre of a normal distribution before it is cut, the mean of any other.
    error : float
        Standard deviation about `value`; zero if the number is known.
    unit : str
        SI unit; empty for a ratio, or where the name of the quantity implies it.
    shape : str
        ``"normal"``, ``"uniform"``, ``"log-uniform"``, or the name of a distribution of `scipy.stats`.
    low, high : float
        Ends of the support.
    family : distribution of scipy.stats, optional
        Distribution, for any other shape.
    arguments : tuple of float
        Its parameters, location and scale last.

    Raises
    ------
    InputError
        On a negative error, or limits of a range that do not rise.

    Examples
    --------
    >>> Quantity.of("24.0 +/- 0.2 um")
    Quantity.of('2.4e-05 +/- 2e-07 m')
    >>> Quantity.of("0.80 .. 0.90 Pa s").ppf(0.0).item()
    0.8
    """

    value: float
    error: float = 0.0
    unit: str = ""
    shape: str = "normal"
    low: float = 0.0
    high: float = math.inf
    family: Any = field(default=None, compare=False)
    arguments: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for key in ("value", "error"):
            if not isinstance(given := getattr(self, key), numbers.Real):
                raise InputError("quantity", key, "a number", repr(given), "Quantity.of reads texts and other forms")
        if self.error < 0.0:
            raise InputError("quantity", "error", "a standard error that is not negative", f"{self.error:g}")
        if self.is_range:
            least = 0.0 if self.shape == "log-uniform" else -math.inf
            if not least < self.low < self.high < math.inf:
                expected = "0 < low < high" if self.shape == "log-uniform" else "low < high"
                raise InputError("quantity", "low, high", expected, f"{self.low:g}, {self.high:g}")

    @classmethod
    def uniform(cls, low: float, high: float, unit: str = "") -> Quantity:
        """Return a quantity with a uniform distribution between two limits."""
        return cls(0.5 * (low + high), abs(high - low) / math.sqrt(12.0), unit, "uniform", low, high)

    @classmethod
    def log_uniform(cls, low: float, high: float, unit: str = "") -> Quantity:
        """Return a quantity whose logarithm is uniform between those of two positive limits."""
        mean = error = math.nan
        if 0.0 < low < high < math.inf:
            decades = math.log(high / low)
            mean = (high - low) / decades
            error = math.sqrt(max(0.5 * (high**2 - low**2) / decades - mean**2, 0.0))
        return cls(mean, error, unit, "log-uniform", low, high)

    @classmethod
    def log_normal(cls, mean: float, error: float, unit: str = "") -> Quantity:
        """Return a log-normal quantity with this mean and standard deviation (of itself, not of its logarithm)."""
        import scipy.stats  # half a second to import

        least, most = _LOG_NORMAL
        if not (mean > 0.0 and least <= error / mean <= most):
            expected = f"a positive mean, and an error from {least:g} to {most:g} times the mean"
            raise InputError("quantity", "log-normal", expected, f"{mean:g} +/- {error:g}")
        variance = math.log1p((error / mean) ** 2)
        made = _of_frozen(scipy.stats.lognorm(math.sqrt(variance), scale=mean * math.exp(-0.5 * variance)), unit)
        return replace(made, value=mean, error=error)

    @classmethod
    def of(
        cls,
        given: object,
        name: str = "",
        *,
        where: str = "quantity",
        key: str | None = None,
        units: Sequence[str] = (),
        example: str = "",
        signed: bool = False,
    ) -> Quantity:
        """Return the quantity that a user gave in any of its forms.

        Parameters
        ----------
        given : Quantity, text, number, pint quantity, or frozen distribution of scipy.stats
            A text as `read` reads it; a number or a distribution is in the first unit.
        name : str
            As in `capsbayes.parameters`, which knows its unit and what is plausible.
        where, key : str
            File or argument, for the message of an error; the key is the name by default.
        units : sequence of str
            SI units allowed, by default that of the parameter.
        example : str
            A text that would have been right, for the message; by default that of the parameter.
        signed : bool
            True if it may be zero or negative.

        Raises
        ------
        InputError
            If it cannot be used: not a quantity, of another unit, not positive, of an error larger than its value
            where it is measured (a name or units are given), or beyond what is plausible.
        """
        key = name if key is None else key
        measured = bool(name or units) and not signed and name not in BELIEVED
        units = tuple(units) or ((PARAMETERS[name].si,) if name in PARAMETERS else SI_UNITS)
        usual = name in STATED and PARAMETERS[name].si in units
        example = example or STATED[name if usual else "half_width"].example
        if isinstance(given, Quantity):
            made = given if given.unit else replace(given, unit=units[0])
            if made.unit not in units:
                raise InputError(where, key, f"a quantity in {' or '.join(units)}", f"one in {made.unit}")
        elif isinstance(given, str):
            made = cls.read(given, where=where, key=key, units=units, example=example, signed=signed)
        elif hasattr(given, "dimensionality"):
            made = _of_pint(given, where, key, units)
        elif hasattr(given, "cdf"):
            made = _of_frozen(given, units[0])
        elif isinstance(given, (int, float, np.floating, np.integer)) and not isinstance(given, bool):
            try:
                made = cls(float(given), unit=units[0])
            except OverflowError:  # an integer of hundreds of digits
                made = cls(math.inf, unit=units[0])
            if signed and not math.isfinite(made.value):
                raise InputError(where, key, "a finite number", repr(made.value))
        else:
            expected = f'a positive number, a text like "{example}" or a frozen distribution of scipy.stats'
            raise InputError(where, key, expected, repr(given))
        if not signed:
            made.check_positive(where, key)
            if measured and made.shape == "normal" and made.error > made.value:
                expected = f"an error of at most the value {made.value:g} {made.unit}".rstrip()
                raise InputError(where, key, expected, f"{made.error:g}")
            made = replace(made, low=0.0) if made.shape == "normal" else made
        if usual and made.unit == PARAMETERS[name].si:
            made._check_plausible(where, key, name, bare=not isinstance(given, str))
        return made

    @classmethod
    def of_text(cls, text: object, name: str, *, where: str, key: str | None = None) -> Quantity:
        """Return the parameter of a name from a file, which holds text alone; see `of` and `read`."""
        if isinstance(text, str) and text.strip():
            return cls.of(text, name, where=where, key=key)
        return cls.read(text, where=where, key=key or name, units=(PARAMETERS[name].si,), example=STATED[name].example)

    @classmethod
    def read(
        cls, text: object, *, where: str, key: str, units: Sequence[str], example: str, signed: bool = False
    ) -> Quantity:
        """Read a text: a number, optionally with its error or a second limit, and a unit.

        Parameters
        ----------
        text : object
            Value of a key; only text can be read. The page on conventions says how a quantity is written. A normal one
            is cut at zero unless signed.
        where, key : str
            File and key, for the message.
        units : sequence of str
            SI units to convert to, one for each dimension allowed; an empty string allows a bare number.
        example : str
            A value that would have been right, for the message.
        signed : bool
            True if zero and negative numbers are allowed.

        Raises
        ------
        InputError
            If the text is no such quantity, or is negative, zero or not finite.

        Examples
        --------
        >>> Quantity.read("50.0 +/- 0.5 um", where="x.toml", key="half_width", units=("m",), example="50 um").unit
        'm'
        """
        names = " or ".join(f"in {unit}" if unit else "without unit" for unit in units)
        wanted = f'a text {names} like "{example}"'
        if not isinstance(text, str) or not text.strip():
            raise InputError(where, key, wanted, "nothing" if text in (None, "") else repr(text))
        numbers = parsed(text, units, where=where, key=key, wanted=wanted)
        usable = all(number == 0.0 or 1.0 / LARGEST <= abs(number) <= LARGEST for number in numbers[:2])
        if not (usable and (signed or numbers.first > 0.0)):
            raise InputError(where, key, f"a {'' if signed else 'positive '}finite number, {wanted}", repr(text))
        if numbers.is_range:
            if not numbers.first < numbers.second or (numbers.shape and numbers.first <= 0.0):
                raise InputError(where, key, "low < high", repr(text))
            if numbers.shape == "log-normal":
                raise InputError(where, key, "a mean and an error after log-normal", repr(text))
            return (cls.log_uniform if numbers.shape else cls.uniform)(numbers.first, numbers.second, numbers.unit)
        if numbers.shape == "log-uniform" or numbers.second < 0.0:
            expected = "a range after log-uniform" if numbers.shape == "log-uniform" else f"an error, {wanted}"
            raise InputError(where, key, expected, repr(text))
        if numbers.shape:
            try:
                return cls.log_normal(numbers.first, numbers.second, numbers.unit)
            except InputError as error:
                raise InputError(where, key, error.expected, repr(text)) from None
        return cls(numbers.first, numbers.second, numbers.unit, low=-math.inf if signed else 0.0)

    @property
    def known(self) -> bool:
        """True for a number without error."""
        return self.error == 0.0

    @cached_property
    def distribution(self) -> Any:
        """Frozen distribution of `scipy.stats` of an uncertain quantity."""
        import scipy.stats  # half a second to import

        if self.family is not None:
            return self.family(*self.arguments)
        if self.shape == "uniform":
            return scipy.stats.uniform(self.low, self.high - self.low)
        if self.shape == "log-uniform":
            return scipy.stats.loguniform(self.low, self.high)
        if self.low == -math.inf:
            return scipy.stats.norm(self.value, self.error)
        cut = (self.low - self.value) / self.error
        return scipy.stats.truncnorm(cut, np.inf, loc=self.value, scale=self.error)

    @property
    def mean(self) -> float:
        """Mean, of a normal distribution after the cut."""
        return self.value if self._as_stated else float(self.distribution.mean())

    @property
    def sd(self) -> float:
        """Standard deviation, of a normal distribution after the cut."""
        return self.error if self._as_stated else float(self.distribution.std())

    @property
    def _as_stated(self) -> bool:
        """True if value and error are mean and standard deviation: no cut is near."""
        return self.known or self.shape != "normal" or self.value - self.low > _FAR * self.error

    @property
    def parameters(self) -> tuple[float, float]:
        """Limits of a range; value and error of any other quantity."""
        return (self.low, self.high) if self.is_range else (self.value, self.error)

    @property
    def power(self) -> int:
        """Exponent k of a range, whose density of log x is proportional to x^k."""
        return 1 if self.shape == "uniform" else 0

    def logpdf(self, values: ArrayLike) -> Floats:
        """Return the log of the density, -inf where it vanishes : array of the shape of `values`."""
        from scipy.special import log_ndtr

        values = np.asarray(values, dtype=np.float64)
        if self.shape == "normal":  # scipy's cut normal takes a hundred times as long
            norm = math.log(self.error * math.sqrt(2.0 * math.pi)) + log_ndtr((self.value - self.low) / self.error)
            return self.log_shape(values) - norm
        if self.is_range:
            within = (values >= self.low) & (values <= self.high)
            if self.power:
                return np.where(within, -math.log(self.high - self.low), -np.inf)
            return np.where(within, -np.log(np.where(within, values, 1.0) * math.log(self.high / self.low)), -np.inf)
        return np.asarray(self.distribution.logpdf(values), dtype=np.float64)

    @property
    def is_range(self) -> bool:
        """True for a uniform or log-uniform range, whose density is a power of x between two limits."""
        return self.shape in ("uniform", "log-uniform")

    @property
    def is_log_normal(self) -> bool:
        """True for a log-normal distribution that begins at zero."""
        return self.shape == "lognorm" and self.arguments[-2] == 0.0

    def log_weight(self, values: ArrayLike) -> Floats:
        """Return the log of the density of log x over x^`power`: that of a range is 0 within it, -inf beyond."""
        values = np.asarray(values, dtype=np.float64)
        if self.is_range:
            return np.where((values >= self.low) & (values <= self.high), 0.0, -np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.logpdf(values) + np.log(values)

    def log_shape(self, values: ArrayLike) -> Floats:
        """Return the log of the density up to a constant, which a normal distribution omits; faster than `logpdf`."""
        if self.shape != "normal":
            return self.logpdf(values)
        values = np.asarray(values, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            return np.where(values > self.low, -0.5 * ((values - self.value) / self.error) ** 2, -np.inf)

    def pdf(self, values: ArrayLike) -> Floats:
        """Return the density : array of the shape of `values`."""
        return np.exp(self.logpdf(values))

    def cdf(self, values: ArrayLike) -> Floats:
        """Return the probability below each value : array of the shape of `values`."""
        return np.asarray(self.distribution.cdf(values), dtype=np.float64)

    def ppf(self, shares: ArrayLike) -> Floats:
        """Return the values below which given shares of the probability lie : array of the shape of `shares`."""
        if not self.is_range:
            return np.asarray(self.distribution.ppf(shares), dtype=np.float64)
        shares = np.asarray(shares, dtype=np.float64)  # scipy takes a hundred times as long for few of them
        if self.power:
            values = shares * (self.high - self.low) + self.low
        else:
            values = np.exp(math.log(self.low) + shares * math.log(self.high / self.low))
        return np.where((shares >= 0.0) & (shares <= 1.0), values, np.nan)

    def drawn(self, rng: np.random.Generator, count: int) -> Floats:
        """Return independent draws : (count,) array."""
        if self.known:
            return np.full(count, self.value)
        return np.asarray(self.distribution.rvs(size=count, random_state=rng), dtype=np.float64)

    def rescaled(self, value: float, factor: float = 1.0) -> Quantity:
        """Return the same shape about another value, with its error multiplied by a factor."""
        if self.shape == "uniform":
            low, high = (value + factor * (end - self.value) for end in (self.low, self.high))
            return Quantity.uniform(low, high, self.unit)
        if self.shape == "normal":
            return replace(self, value=value, error=factor * self.error)
        made = self if self.family is not None else _of_frozen(self.distribution, self.unit)
        *shapes, place, scale = made.arguments
        return _of_family(made.family, (*shapes, value + factor * (place - self.value), factor * scale), self.unit)

    def check_positive(self, where: str, key: str) -> None:
        """Refuse a quantity that is not positive and finite."""
        if not (self.value > 0.0 and math.isfinite(self.value) and math.isfinite(self.error)):
            got = f"{self.value:g}" + ("" if self.known else f" with a standard deviation of {self.error:g}")
            raise InputError(where, key, "a positive finite number or a distribution of finite variance", got)
        below = 0.0 if self.known or self.low >= 0.0 else float(self.cdf(0.0))
        if below > _NEGATIVE_SHARE:
            raise InputError(where, key, "a positive distribution", f"{below:.2g} of it below zero", "cut it at zero")

    def _check_plausible(self, where: str, key: str, name: str, *, bare: bool) -> None:
        """Refuse what no experiment has: usually a number in another unit than that in which it was read."""
        known, (_, least, most) = PARAMETERS[name], STATED[name]
        if least <= self.value <= most:
            if self.shape == "normal" and self.error > most:
                raise InputError(where, key, f"a standard error of at most {most:g} {known.unit}", f"{self.error:g}")
            return
        unit, shown = (self.unit, known.shown_unit) if self.unit else (known.unit, "um")  # a length over l
        shown = shown.replace("µ", "u")  # as it can be typed
        likely = not self.unit or least <= self.value / known.scale <= most
        advice = f'did you mean "{self.value:g} {shown}"?' if likely else "check the unit"
        read = f" (read in {unit})" if bare else ""
        raise InputError(
            where, key, f"a value from {least:g} to {most:g} {unit}", f"{self.value:g} {unit}{read}", advice
        )

    def as_record(self) -> Any:
        """Return a number, or the name and the parameters of a distribution of scipy.stats, ready for JSON."""
        if self.known:
            return self.value
        frozen, arguments = self.distribution, list(map(json_number, self.distribution.args))
        keywords = {name: json_number(value) for name, value in frozen.kwds.items()}
        return {"distribution": frozen.dist.name, "arguments": arguments, "keywords": keywords}

    @classmethod
    def of_record(cls, stated: Any, unit: str = "") -> Quantity:
        """Return the quantity of which `as_record` gave the record; a ValueError names an unknown distribution."""
        if not isinstance(stated, dict):
            return cls(float(stated), unit=unit)
        import scipy.stats  # half a second to import

        family = getattr(scipy.stats, stated["distribution"], None)
        if family is None:
            raise ValueError(f"a distribution of scipy.stats named {stated['distribution']!r}")
        if stated["distribution"] == "loguniform" and len(stated["arguments"]) == 2 and not stated["keywords"]:
            low, high = map(float, stated["arguments"])
            return cls.log_uniform(low, high, unit)
        keywords = {name: float(value) for name, value in stated["keywords"].items()}
        return _of_frozen(family(*map(float, stated["arguments"]), **keywords), unit)

    def shown(self, name: str) -> str:
        """Return the text form in the display unit.

        Examples
        --------
        >>> Quantity(25e-6, 2e-7, "m").shown("half_width")
        '25 +/- 0.2 µm'
        """
        known = PARAMETERS[name]
        scale, unit = known.scale, known.shown_unit
        if self.unit == "m" and known.unit == "l":
            scale, unit = 1e6, "µm"
        first, second = (scale * number for number in self.parameters)
        if self.family is not None:
            kind = "log-normal" if self.is_log_normal else self.shape
            return f"{kind}, {first:.4g} +/- {second:.2g} {unit}"
        if self.is_range:
            return f"{'' if self.power else 'log-uniform '}{first:.4g} .. {second:.4g} {unit}"
        return f"{first:.4g} {'' if self.known else f'+/- {second:.2g} '}{unit}"

    def __str__(self) -> str:
        if self.shape == "normal":
            number = repr(float(self.value)) + (f" +/- {float(self.error)!r}" if self.error else "")
        elif self.is_log_normal:
            number = f"log-normal {float(self.value)!r} +/- {float(self.error)!r}"
        elif self.family is None:
            start = "log-uniform " if self.shape == "log-uniform" else ""
            number = f"{start}{float(self.low)!r} .. {float(self.high)!r}"
        else:
            number = f"{self.shape} of mean {self.value!r} and standard deviation {self.error!r}"
        return f"{number} {self.unit}".rstrip()

    def __repr__(self) -> str:
        return f"Quantity.of({str(self)!r})"


def uncertain(
    given: object,
    name: str = "",
    *,
    where: str,
    key: str = "",
    units: Sequence[str],
    example: str = "",
    signed: bool = False,
    normal: bool = True,
) -> Quantity:
    """Return a quantity, see `Quantity.of`, that needs a standard error, and is `normal` unless others will do."""
    made = Quantity.of(given, name, where=where, key=key, units=units, example=example, signed=signed)
    if made.known or (normal and made.shape != "normal"):
        expected = f'a standard error, as in "{example or STATED[name].example}"'
        raise InputError(where, key, expected, repr(given) if isinstance(given, str) else str(given))
    return made


def _of_pint(given: Any, where: str, key: str, units: Sequence[str]) -> Quantity:
    """Return a quantity of pint, whose magnitude may be a number with an error of `uncertainties`, in SI."""
    for unit in units:
        if given.is_compatible_with(unit or "dimensionless"):
            magnitude = given.to(unit or "dimensionless").magnitude
            value = float(getattr(magnitude, "nominal_value", magnitude))
            return Quantity(value, float(getattr(magnitude, "std_dev", 0.0)), unit)
    raise InputError(where, key, f"a quantity in {' or '.join(units)}", str(given))


def _of_frozen(given: Any, unit: str) -> Quantity:
    """Return the quantity of a frozen distribution of scipy.stats."""
    shapes, place, scale = given.dist._parse_args(*given.args, **given.kwds)
    return _of_family(given.dist, tuple(map(float, (*shapes, place, scale))), unit)


def _of_family(family: Any, arguments: tuple[float, ...], unit: str) -> Quantity:
    name, (place, scale) = family.name, arguments[-2:]
    if name == "norm":
        return Quantity(place, scale, unit, low=-math.inf)
    if name == "uniform":
        return Quantity.uniform(place, place + scale, unit)
    if name == "truncnorm" and arguments[1] == math.inf and abs(place + arguments[0] * scale) <= 1e-9 * abs(place):
        return Quantity(place, scale, unit)
    frozen = family(*arguments)
    low, high = map(float, frozen.support())
    return Quantity(float(frozen.mean()), float(frozen.std()), unit, name, low, high, family, arguments)


def json_number(value: float) -> float | str:
    """Return a number that JSON knows; an infinite one or NaN as text."""
    return float(value) if math.isfinite(value) else repr(float(value))
