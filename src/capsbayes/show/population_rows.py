"""What a page reads of the table of many capsules: its columns, its order, and the table to sort."""

from __future__ import annotations

from collections import Counter

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.parameters import PARAMETERS
from capsbayes.show.page import table, typeset
from capsbayes.show.rounding import decimals, interval_words, together, unit_of
from capsbayes.status import Status

__all__ = ["MODULUS", "RADIUS", "check_population", "column", "done", "row_table", "status_table", "worst_first"]

Floats = NDArray[np.float64]

MODULUS, RADIUS = "surface_shear_modulus", "capsule_radius"
_SHOWN = (MODULUS, RADIUS, "capillary_number", "size_ratio", "mean_velocity", "velocity_ratio", "stretch_ratio")
_NEEDED = tuple(f"{name}_{kind}" for name in (MODULUS, RADIUS) for kind in ("median", "lower_95", "upper_95"))


def check_population(population: xr.Dataset, where: str) -> None:
    """Refuse a dataset that is no table of capsules.

    Raises
    ------
    InputError
        Naming what is missing.
    """
    if "capsule" not in population.sizes:
        raise InputError(
            where, "", "a table with the dimension capsule", f"one with {', '.join(map(str, population.sizes))}"
        )
    for name in ("status", *_NEEDED):
        if name not in population.variables:
            raise InputError(where, name, "a variable of that name", "none")
    unknown = sorted(set(_texts(population, "status")) - set(Status.__members__))
    if unknown:
        raise InputError(where, "status", "names of capsbayes.Status", ", ".join(unknown))


def column(population: xr.Dataset, name: str, kind: str) -> Floats:
    """One summary of a quantity in SI, as ``"median"`` : (n,) array, NaN where there is none."""
    variable = f"{name}_{kind}"
    if variable not in population.variables:
        return np.full(population.sizes["capsule"], np.nan)
    return np.asarray(population[variable].values, dtype=float)


def done(population: xr.Dataset) -> NDArray[np.bool_]:
    """Capsules whose intervals can be used : (n,) array."""
    return np.array([Status[name].ok for name in _texts(population, "status")], dtype=bool)


def worst_first(population: xr.Dataset) -> NDArray[np.int64]:
    """Order of the capsules: those that did not end as they should, then by falling relative width of G_s : (n,)."""
    ends = [column(population, MODULUS, kind) for kind in ("lower_95", "upper_95")]
    with np.errstate(invalid="ignore", divide="ignore"):
        width = np.log(ends[1] / ends[0])
    return np.lexsort((-np.where(np.isfinite(width), width, np.inf), done(population)))


def status_table(population: xr.Dataset) -> Markup:
    """How many capsules ended how, the most frequent first."""
    counts = Counter(_texts(population, "status")).most_common()
    rows = [(str(count), Status[name].name, str(Status[name])) for name, count in counts]
    return table(("capsules", "status", "what it means"), rows, numbers=(0,))


def row_table(population: xr.Dataset, *, most: int) -> Markup:
    """The capsules, worst first, at most so many; its headings sort it where scripts run."""
    shown = [name for name in _SHOWN if f"{name}_median" in population.variables]
    heads = [("no.", True), ("capsule", False), ("status", False)]
    heads += [(_heading(name), True) for name in shown]
    heads.insert(4, (Markup("{}: 95 % interval").format(typeset(PARAMETERS[MODULUS].symbol)), True))
    head = Markup().join(_head(text, number=number) for text, number in heads)
    order = worst_first(population)[:most]
    texts = {key: _texts(population, key) for key in ("name", "status")}
    values = {name: [column(population, name, kind) for kind in ("median", "lower_68", "upper_68")] for name in shown}
    ends = [column(population, MODULUS, kind) for kind in ("lower_95", "upper_95")]
    lines = []
    for rank, k in enumerate(order, start=1):
        cells = [_number(float(rank), str(rank)), _text(texts["name"][k]), _text(texts["status"][k])]
        cells += [_quantity(name, *(float(one[k]) for one in values[name])) for name in shown]
        cells.insert(4, _interval(float(ends[0][k]), float(ends[1][k])))
        lines.append(Markup("<tr>{}</tr>").format(Markup().join(cells)))
    body = Markup("\n").join(lines)
    return Markup(
        '<div class="wide" tabindex="0"><table class="sortable">\n<thead><tr>{}</tr></thead>\n<tbody>\n{}\n</tbody>'
        "</table></div>"
    ).format(head, body)


def _texts(population: xr.Dataset, name: str) -> list[str]:
    """Text of every capsule; of a missing name, its number."""
    if name not in population.variables:
        return [str(k) for k in range(1, population.sizes["capsule"] + 1)]
    return [one.decode() if isinstance(one, bytes) else str(one) for one in population[name].values]


def _heading(name: str) -> Markup:
    one = PARAMETERS[name]
    unit = unit_of(one).strip()
    return Markup("{}{}").format(typeset(one.symbol), f" [{unit}]" if unit else "")


def _head(text: str, *, number: bool) -> Markup:
    kind = Markup(' class="number"') if number else ""
    return Markup('<th scope="col"{}><button type="button">{}</button></th>').format(kind, text)


def _text(text: str) -> Markup:
    return Markup("<td>{}</td>").format(text)


def _number(value: float, text: str) -> Markup:
    key = f"{value:.9g}" if np.isfinite(value) else ""
    return Markup('<td class="number" data-value="{}">{}</td>').format(key, text)


def _quantity(name: str, median: float, low: float, high: float) -> Markup:
    one = PARAMETERS[name]
    if not np.isfinite(median):
        return _number(np.nan, "–")
    return _number(one.shown(median), *together((one.shown(median),), _digits(name, median, low, high)))


def _interval(low: float, high: float) -> Markup:
    """The 95 % interval of G_s, sorted by the ratio of its ends."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return _number(np.nan, "–")
    return _number(high / low, interval_words(MODULUS, low, high, _digits(MODULUS, low, low, 0.5 * (low + high))))


def _digits(name: str, median: float, low: float, high: float) -> int:
    """Decimals worth showing; three digits where no interval is known."""
    error = 0.5 * (high - low)
    return decimals(PARAMETERS[name].shown(error if np.isfinite(error) and error > 0.0 else 1e-3 * abs(median)))
