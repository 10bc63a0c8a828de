"""Numbers in text with units and errors: ``"50.0 +/- 0.5 um"`` becomes SI."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

from capsbayes.errors import InputError

__all__ = ["Quantity", "quantity"]

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


@dataclass(frozen=True)
class Quantity:
    """A number with its standard error.

    Parameters
    ----------
    value : float
        In SI, or a ratio when `unit` is empty.
    error : float
        Standard error in the same unit; zero if the number is known.
    unit : str
        SI unit, empty for a ratio.
    """

    value: float
    error: float
    unit: str


@functools.cache
def _registry() -> Any:
    """Return the registry of the units an experiment needs, built when a text is first read.

    The whole registry of pint takes a fifth of a second more, and knows units
    that nobody means: "a" would be a year and "l", which is the half width here, a litre.
    """
    import pint

    registry: Any = pint.UnitRegistry(None)
    registry.load_definitions(_UNITS.splitlines())
    return registry


def quantity(
    text: object, *, where: str, key: str, units: tuple[str, ...], example: str, signed: bool = False
) -> Quantity:
    """Read one quantity.

    Parameters
    ----------
    text : object
        What the file holds; only text can be read. ``+/-`` or ``±`` announces
        the standard error.
    where, key : str
        File and key, for the message.
    units : tuple of str
        SI units to convert to, one for each dimension allowed; an empty
        string allows a bare number (a ratio, never a percentage).
    example : str
        A value that would have been right, for the message.
    signed : bool
        Whether zero and negative numbers are allowed.

    Returns
    -------
    Quantity

    Raises
    ------
    InputError
        If the text is no such quantity, or is negative, zero or not finite.

    Examples
    --------
    >>> quantity("50.0 +/- 0.5 um", where="x.toml", key="half_width", units=("m",), example="50 um").unit
    'm'
    """
    names = " or ".join(f"in {unit}" if unit else "without unit" for unit in units)
    wanted = f'a text {names} like "{example}"'
    if not isinstance(text, str) or not text.strip():
        raise InputError(where, key, wanted, "nothing" if text in (None, "") else repr(text))
    parsed = _parsed(text, where, key, wanted)
    unit = next((unit for unit in units if _fits(parsed, unit)), None)
    if unit is None:
        raise InputError(where, key, wanted, f"{'no unit' if _bare(parsed) else parsed.units} in {text!r}")
    magnitude = parsed.to(unit or "dimensionless").magnitude
    value = float(getattr(magnitude, "nominal_value", magnitude))
    error = float(getattr(magnitude, "std_dev", 0.0))
    if not (math.isfinite(value) and (signed or value > 0.0)):
        raise InputError(where, key, f"a {'' if signed else 'positive '}finite number, {wanted}", repr(text))
    if not (math.isfinite(error) and error >= 0.0):
        raise InputError(where, key, f"a finite error, {wanted}", repr(text))
    return Quantity(value, error, unit)


def _parsed(text: str, where: str, key: str, wanted: str) -> Any:
    import pint

    try:
        return _registry().Quantity(_registry().parse_expression(text))
    except pint.UndefinedUnitError:
        raise InputError(where, key, wanted, f"an unknown unit in {text!r}") from None
    except Exception:  # the parser has an exception of its own for each way to be wrong
        raise InputError(where, key, wanted, repr(text)) from None


def _bare(parsed: Any) -> bool:
    return bool(parsed.units == _registry().dimensionless)


def _fits(parsed: Any, unit: str) -> bool:
    if not unit:
        return _bare(parsed)
    return bool(parsed.dimensionality == _registry().Unit(unit).dimensionality)
