"""A stated range of an input: from low to high with equal probability, or a mean with its standard error."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from capsbayes.errors import InputError
from capsbayes.quantity import Quantity

__all__ = ["Spread"]

_UNITS = {
    "viscosity": (("Pa s",), "0.80 .. 0.90 Pa s"),
    "half_width": (("m",), "24.5 .. 25.5 um"),
    "capsule_velocity": (("m/s",), "6.1 .. 6.3 mm/s"),
    "axial_extent": (("", "m"), "2.10 .. 2.18"),
    "axial_length": (("", "m"), "1.77 .. 1.85"),
}
_RANGE = re.compile(r"\s*([-+.\deE]+)\s*\.\.\s*([-+.\deE]+)\s*(.*?)\s*")


@dataclass(frozen=True)
class Spread:
    """Range of one input.

    Parameters
    ----------
    kind : str
        ``"uniform"`` from `first` to `second`, or ``"normal"`` about `first` with standard deviation `second`.
    first, second : float
        In SI, or over l.

    Raises
    ------
    InputError
        If it is no range of a positive quantity.

    Examples
    --------
    >>> Spread.of_text("0.80 .. 0.90 Pa s", name="viscosity")
    Spread(kind='uniform', first=0.8, second=0.9)
    >>> Spread.of_text("2.14 +/- 0.02", name="axial_extent").sd
    0.02
    """

    kind: str
    first: float
    second: float

    def __post_init__(self) -> None:
        finite = np.isfinite([self.first, self.second]).all()
        if self.kind == "uniform" and finite and 0.0 < self.first < self.second:
            return
        if self.kind == "normal" and finite and 0.0 < 4.0 * self.second < self.first:
            return
        expected = '"uniform" with 0 < low < high, or "normal" with an error below a quarter of the mean'
        raise InputError("range", "", expected, f'"{self.kind}" {self.first:g}, {self.second:g}')

    @classmethod
    def of_text(cls, text: str, *, name: str, where: str = "--range") -> Spread:
        """Read ``"0.80 .. 0.90 Pa s"`` or ``"0.85 +/- 0.02 Pa s"``.

        Parameters
        ----------
        text : str
        name : str
            Of the input, as in `capsbayes.parameters`.
        where : str
            For the message of an error.
        """
        if name not in _UNITS:
            raise InputError(where, name, f"one of {', '.join(_UNITS)}", "an unknown input")
        units, example = _UNITS[name]
        found = _RANGE.fullmatch(text)
        if found is None:
            one = Quantity.read(text, where=where, key=name, units=units, example=example)
            if one.error == 0.0:
                raise InputError(where, name, f'a range like "{example}" or a value with "+/-"', repr(text))
            return cls("normal", one.value, one.error)
        ends = [
            Quantity.read(f"{found[k]} {found[3]}".strip(), where=where, key=name, units=units, example=example).value
            for k in (1, 2)
        ]
        if not ends[0] < ends[1]:
            raise InputError(where, name, "low < high", repr(text))
        return cls("uniform", ends[0], ends[1])

    @property
    def sd(self) -> float:
        """Standard deviation."""
        return (self.second - self.first) / float(np.sqrt(12.0)) if self.kind == "uniform" else self.second
