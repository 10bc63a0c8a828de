"""Tables of many capsules: their statuses, their medians, what they have in common, and the capsules one by one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from capsbayes.infer.population import Population
from capsbayes.parameters import PARAMETERS
from capsbayes.show.tables.table import Code, Number, Symbols, flat, table
from capsbayes.show.words.population import hierarchy_title
from capsbayes.show.words.rounding import decimals, interval_words, together, two_digits
from capsbayes.status import Status

_MODULUS = "surface_shear_modulus"
_SHOWN = (
    *(_MODULUS, "capsule_radius", "capillary_number", "size_ratio"),
    *("mean_velocity", "velocity_ratio", "stretch_ratio"),
)
_KINDS = ("median", "lower_68", "upper_68", "lower_95", "upper_95")


def status_table(counts: Mapping[Status, int], what: str = "capsules") -> pd.DataFrame:
    """Return how many ended with which status, the most frequent first."""
    rows = [(str(count), status.name, str(status)) for status, count in counts.items()]
    return table((what, "status", "what it means"), rows, numbers=(0,))


def summary_table(population: Population) -> pd.DataFrame:
    """Return median and quartiles of the medians of the usable capsules, and the error of one capsule."""
    rows = []
    for name, row in population.summary().iterrows():
        shown = PARAMETERS[str(name)].shown
        digits = two_digits(shown(row["error"]))
        middle, low, high, error = together(
            [shown(row[key]) for key in ("median", "lower_quartile", "upper_quartile", "error")], digits
        )
        rows.append((Symbols(PARAMETERS[str(name)].label), middle, f"{low} to {high}", error))
    head = ("", "median", "quartiles", "error of one capsule, 68 %")
    return table(head, rows, title="Of the capsules that can be used", numbers=(1, 2, 3))


def hierarchy_table(stored: Mapping[str, Any]) -> pd.DataFrame:
    """Return medians, 68 and 95 % intervals of mean, spread and slope; `stored` is ``Hierarchy.as_dict()``."""
    rows = []
    for name, summary in stored["quantities"].items():
        parameter = PARAMETERS[name]
        numbers = [parameter.shown(summary[key]) for key in _KINDS]
        middle, *ends = together(numbers, decimals(0.25 * (numbers[4] - numbers[3])))
        rows.append((Symbols(parameter.label), middle, " to ".join(ends[:2]), " to ".join(ends[2:])))
    head = ("", "median", "68 % interval", "95 % interval")
    return table(head, rows, title=hierarchy_title(stored), numbers=(1, 2, 3))


def capsule_table(population: Population, *, most: int) -> pd.DataFrame:
    """Return the capsules, worst first, at most so many."""
    shown = [name for name in _SHOWN if f"{name}_median" in population.dataset]
    head = ["no.", "capsule", "status", *(Symbols(PARAMETERS[name].label) for name in shown)]
    head[4:4] = [Symbols(f"{PARAMETERS[_MODULUS].symbol}: {level} % interval") for level in (68, 95)]
    names = population["name"] if "name" in population.dataset else np.full(len(population), "")
    summaries = {name: np.stack([population[f"{name}_{kind}"] for kind in _KINDS], axis=1) for name in shown}
    statuses = population["status"]
    rows = []
    for rank, k in enumerate(population.worst_first()[:most], start=1):
        cells = [Number(str(rank), rank), str(names[k]) or str(k + 1), str(statuses[k])]
        cells += [_median(name, *summaries[name][k, :3]) for name in shown]
        cells[4:4] = [_interval(*summaries[_MODULUS][k, ends]) for ends in (slice(1, 3), slice(3, 5))]
        rows.append(cells)
    return table(head, rows, numbers=(0, *range(3, len(head))))


def origin_table(population: Population, source: str) -> pd.DataFrame:
    """Return file and attributes; the population itself has a table of its own."""
    attributes = {name: value for name, value in population.attributes.items() if name != "hierarchy"}
    lines = [("file", source)] if source else []
    lines += flat(attributes)
    return table(("", ""), [(name, Code(value) if _is_code(value) else value) for name, value in lines])


def _median(name: str, median: float, low: float, high: float) -> Number:
    if not np.isfinite(median):
        return Number("–", np.nan)
    shown = PARAMETERS[name].shown(median)
    (text,) = together((shown,), _digits(name, median, low, high))
    return Number(text, shown)


def _interval(low: float, high: float) -> Number:
    """An interval of G_s, sorted by the ratio of its ends."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return Number("–", np.nan)
    digits = _digits(_MODULUS, low, low, 0.5 * (low + high))
    return Number(interval_words(_MODULUS, low, high, digits), high / low)


def _digits(name: str, median: float, low: float, high: float) -> int:
    """Decimals worth showing; three digits where no interval is known."""
    error = 0.5 * (high - low)
    return decimals(PARAMETERS[name].shown(error if np.isfinite(error) and error > 0.0 else 1e-3 * abs(median)))


def _is_code(value: str) -> bool:
    return len(value) > 40 and " " not in value.strip()
