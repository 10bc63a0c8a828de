"""Columns of a table with units: in the heading, or in each cell, as a text or as a quantity of pint."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.errors import InputError
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity
from capsbayes.units import parsed

if TYPE_CHECKING:
    import pandas as pd

_WITH_UNIT = re.compile(r"(?P<name>\w+)\s*[\[(](?P<unit>[^\])]*)[\])]")
_STATES_ERROR = re.compile(r"±|\+\s?/?\s?-")
_ERROR = "_error"


def usual_columns(frame: pd.DataFrame, headings: Mapping[str, str], source: str) -> pd.DataFrame:
    """Return a table whose columns have the usual headings, for one whose columns may be headed otherwise.

    Parameters
    ----------
    frame : DataFrame
        ``capsule_velocity [mm/s]`` is a column of numbers, or of texts as ``"4.86 +/- 0.04"``, in this unit;
        ``capsule_velocity`` one of numbers in SI (of lengths, over l), of quantities of pint, or of texts as
        ``"4.86 +/- 0.04 mm/s"``. The errors of texts make a column of their own.
    headings : mapping of str
        Usual heading, which is that of SI, of each number by its name.
    source : str
        For the message of an error.

    Raises
    ------
    InputError
        On a unit that cannot be read or is not that of the number, or if two columns state the same number.
    """
    columns: dict[str, Any] = {}
    for heading, values in frame.items():
        found = _WITH_UNIT.fullmatch(str(heading))
        name = found["name"] if found else str(heading)
        if name not in headings or (name == headings[name] and not found):
            made = {str(heading): values}
        elif found:
            made = _of_cells(name, values, headings, *_factor(name, found["unit"], source, str(heading)))
        else:
            made = _of_cells(name, values, headings)
        for key, of in made.items():
            if key in columns:
                raise InputError(source, str(heading), "one statement of each number", f"a second one of {key}")
            columns[key] = of
    return type(frame)(columns)


def _target(name: str) -> str:
    """Return the SI unit of a number, empty for a ratio."""
    base = name.removesuffix(_ERROR)
    return PARAMETERS[base].si if base in PARAMETERS else ""


def _factor(name: str, unit: str, source: str, heading: str) -> tuple[float, str]:
    """Return what a number in a unit is in SI, and the unit."""
    target = _target(name)
    wanted = f"a unit of {name.removesuffix(_ERROR).replace('_', ' ')}" + (
        f", as {target}" if target else f": none, as it is {'over l' if 'axial' in name else 'a ratio'}"
    )
    if not unit.strip() or unit.strip() in ("l", "-"):
        if target:
            raise InputError(source, heading, wanted, repr(unit))
        return 1.0, ""
    found = parsed(f"1 {unit}", (target,), where=source, key=heading, wanted=wanted)
    if found.second or found.is_range:
        raise InputError(source, heading, wanted, repr(unit))
    return found.first, unit


def _of_cells(
    name: str, values: pd.Series, headings: Mapping[str, str], factor: float = 1.0, unit: str = ""
) -> dict[str, Any]:
    """Return the column of a number, and that of its errors if its cells state any."""
    import pandas as pd

    if pd.api.types.is_numeric_dtype(values.dtype) and values.dtype.kind in "fiu":
        return {headings[name]: factor * values}
    cells = [_cell(value, name, factor, unit) for value in values]
    if f"{name}{_ERROR}" not in headings:  # as of a viscosity, whose error is that of the experiment
        cells = [(str(value), np.nan) if cell[1] > 0.0 else cell for value, cell in zip(values, cells, strict=True)]
    made = {headings[name]: pd.Series([cell[0] for cell in cells], index=values.index, dtype=object)}
    errors = np.array([cell[1] for cell in cells])
    stated = any(isinstance(cell[0], str) and _STATES_ERROR.search(cell[0]) for cell in cells) or np.any(errors > 0.0)
    if stated and f"{name}{_ERROR}" in headings:
        made[headings[f"{name}{_ERROR}"]] = pd.Series(errors, index=values.index)
    return made


def _cell(value: Any, name: str, factor: float, unit: str) -> tuple[Any, float]:
    """Return value and error in SI of a cell, by its column's unit; one that cannot be read as it is, to be refused."""
    if (
        value is None
        or (isinstance(value, float) and np.isnan(value))
        or (isinstance(value, str) and not value.strip())
    ):
        return np.nan, np.nan
    target, text = _target(name), isinstance(value, str)
    try:
        read = Quantity.of(
            f"{value} {unit}" if text and unit else value, units=(target,), where="table", key=name, signed=True
        )
    except InputError:
        return str(value), np.nan
    if read.shape != "normal":
        return str(value), np.nan
    scale = 1.0 if text else factor
    return scale * read.value, scale * read.error if read.error else np.nan
