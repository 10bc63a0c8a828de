"""Sentences and tables of many capsules, on the terminal as on their page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from capsbayes.infer.checks import DOUBTFUL_P, FAR
from capsbayes.infer.hierarchy import Hierarchy, ModulusSpread
from capsbayes.infer.population import Population
from capsbayes.infer.prior import Marginal
from capsbayes.infer.selection import NORMAL
from capsbayes.infer.verdict import PREDICTED
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import (
    counted,
    decimals,
    interval_words,
    per_cent,
    together,
    two_digits,
    unit_of,
    value_words,
)
from capsbayes.report.tables import Code, Number, Strong, Symbols, flat, table
from capsbayes.status import Status

_MODULUS = PARAMETERS["surface_shear_modulus"]
_HASH = 40  # letters; a word with more is none of a sentence
_MANY_LEANING = 0.05  # of the capsules on the border
SHOWN = (
    *("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio"),
    *("mean_velocity", "velocity_ratio", "stretch_ratio"),
)
KINDS = ("median", "lower_68", "upper_68", "lower_95", "upper_95")


def headline(population: Population) -> str:
    """Return the median of the median G_s of the usable capsules, and the range of 95 % of them, errors in them."""
    summary = population.summary()
    if summary.empty:
        return "No capsule could be identified."
    row: dict[Any, Any] = summary.loc[_MODULUS.name].to_dict()
    middle, low, high = (_MODULUS.shown(row[key]) for key in ("median", "lower_95", "upper_95"))
    digits = decimals(max(0.25 * (high - low), 1e-3 * middle))
    unit, (shown, *ends) = unit_of(_MODULUS), together((middle, low, high), digits)
    return f"Median G_s = {shown}{unit}, 95 % of the capsules from {' to '.join(ends)}{unit}"


def width_words(population: Population) -> str:
    """Say how well G_s of a single capsule is known."""
    half = population.typical_width()
    if not np.isfinite(half):
        return ""
    used = int(population.usable.sum())
    return (
        f"Median of {counted(used, 'capsule')}; the 95 % interval of a single capsule is typically ± {per_cent(half)}."
    )


def status_words(population: Population) -> str:
    """Say how many capsules have intervals that can be used."""
    number, used = len(population), int(population.usable.sum())
    if used == number:
        return f"The intervals of {'all ' * (number > 1)}{counted(number, 'capsule')} can be used."
    others = "the other one is" if number - used == 1 else f"the other {number - used} are"
    return f"The intervals of {used} of {number} capsules can be used; {others} omitted from the numbers above."


def p_value_words(population: Population) -> str:
    """Say that more predictive p-values are small than would be expected; empty if not."""
    columns = [population[name] for name in map("p_value_{}".format, PREDICTED) if name in population.dataset]
    p_values = np.concatenate([column[np.isfinite(column)] for column in columns]) if columns else np.empty(0)
    number, small = len(p_values), int(np.sum(p_values < DOUBTFUL_P))
    if stats.binom.sf(small - 1, number, DOUBTFUL_P) >= DOUBTFUL_P:
        return ""
    return (
        f"{small} of {number} predictive p-values of the lengths and flow rates are below {DOUBTFUL_P:g}, where "
        f"{DOUBTFUL_P * number:.0f} would be expected: check the stated errors, or diagnose what the model lacks."
    )


def hierarchy_title(stored: Mapping[str, Any]) -> str:
    """Return the title of the table of a population; `stored` is ``Hierarchy.as_dict()``, as in the file of a run."""
    least = stored["least_stretch"]
    kept = "" if least is None else f" with Lambda above {least:g}, which is accounted for"
    return f"The population: {stored['capsules']} capsules{kept}, their errors removed"


def shared_words(stored: Mapping[str, Any]) -> str:
    """Say which part of the uncertainty more capsules would not reduce."""
    shares = stored["share_of_variance_owed_to_what_all_share"].items()
    listed = ", ".join(f"{PARAMETERS[name].symbol} {per_cent(share)}" for name, share in shares)
    medians = "medians by the capsules alone" if stored.get("update") else "medians"
    return f"Share of the variance of the {medians} owed to errors that all capsules share: {listed}."


def update_words(stored: Mapping[str, Any]) -> str:
    """Say what was stated of the median G_s, what it is by the capsules alone, and with both; empty if not stated."""
    if (update := stored.get("update")) is None:
        return ""
    of = {"stated of the batch": update["stated"], "by the capsules alone": update["alone"]}
    of["together"] = stored["quantities"][_MODULUS.name]
    words = (f"{name}: {value_words(_MODULUS.name, Marginal(**summary))}" for name, summary in of.items())
    return f"Median {'; '.join(words)}."


def missing_words(stored: Mapping[str, Any]) -> str:
    """Say how many capsules are missing because they were too soft, and what modelling them changes; empty if none."""
    missing = stored.get("missing")
    if missing is None or missing["median"] < 1.0:
        return ""
    number, low, high = (f"{missing[key]:.0f}" for key in ("median", "lower_95", "upper_95"))
    changes = " and ".join(
        f"{PARAMETERS[name].symbol} by {'-' if change < 0.0 else '+'}{per_cent(abs(change))}"
        for name, change in stored["changes_by_the_missing"].items()
    )
    return (
        f"Missing among the {stored['capsules']}, as too soft for a steady shape in their flow: probably "
        f"{counted(int(number), 'capsule')}, 95 % [{low}, {high}]. This is accounted for; it changes the median "
        f"{changes}."
    )


def caveats(stored: Mapping[str, Any]) -> list[str]:
    """Return what a reader of the population must keep in mind, one sentence each; empty if nothing."""
    sentences = [
        f"Do not use the intervals of the population: {gate['name']} is {gate['value']:.4g}, wanted {gate['wanted']}."
        for gate in stored["gates"]
        if not gate["passed"]
    ]
    leaning = stored["share_leaning_on_border"]
    if leaning > _MANY_LEANING:
        words = "of the capsules lean on the border of the model: the population may extend beyond it."
        sentences.append(f"{per_cent(leaning)} {words}")
    update = stored.get("update")
    if update and update["apart"] > FAR:
        sentences.append(
            f"The capsules and the median G_s stated of their batch are {update['apart']:.1f} standard deviations "
            "apart: one of the two is probably wrong, and the intervals mix both."
        )
    return sentences + [_tail_words(name, stored) for name in stored.get("odd_tails", ())]


def _tail_words(name: str, stored: Mapping[str, Any]) -> str:
    """Say what tails that are not those of the population fitted mean for the intervals."""
    symbol, p = PARAMETERS[name].symbol, stored["tail_p_values"][name]
    if p > 0.5:
        return (
            f"The distribution of {symbol} has lighter tails than the population fitted (posterior predictive p-value "
            f"{p:.3f}), as that of sorted capsules or of two kinds has: the interval of its spread is too wide."
        )
    fitted, advice = "t distributions", "look for odd capsules among them"
    if stored["tails"] == NORMAL:
        fitted, advice = "a normal distribution", "repeat with t distributions (capsbayes population --tails student)"
    return (
        f"The distribution of {symbol} has heavier tails than {fitted} (posterior predictive p-value {p:.3f}): do not "
        f"use the interval of its spread; {advice}."
    )


def spread_words(stored: Mapping[str, Any] | ModulusSpread) -> str:
    """Say how much G_s differs from capsule to capsule, by ``Hierarchy.as_dict()`` or by a spread from elsewhere."""
    if isinstance(stored, ModulusSpread):
        medians, spreads, tails = stored.median, stored.relative, NORMAL
    else:
        tails = stored.get("tails", NORMAL)
        medians, spreads = (
            np.array([stored["quantities"][name][key] for key in ("median", "lower_95", "upper_95")])
            for name in (_MODULUS.name, "modulus_spread")
        )
    middle, low, high = map(_MODULUS.shown, medians)
    shown, *ends = together((middle, low, high), decimals(0.25 * (high - low) or 1e-3 * middle))
    known = f", 95 % [{', '.join(ends)}]" if high > low else ""
    spread, *sds = map(per_cent, spreads)
    band = f", 95 % [{', '.join(sds)}]" if spreads[2] > spreads[1] else ""
    width = "standard deviation of ln G_s" if tails == NORMAL else "half the width of the central 68.3 % of ln G_s"
    return (
        f"With the errors removed, the median G_s of the capsules is {shown}{unit_of(_MODULUS)}{known}, and they "
        f"differ from it by {spread} ({width}{band})."
    )


def usable(stored: Mapping[str, Any]) -> bool:
    """Return whether the checks of a population passed, and its G_s has no heavier tails than those fitted."""
    heavy = _MODULUS.name in stored.get("odd_tails", ()) and stored["tail_p_values"][_MODULUS.name] <= 0.5
    return not heavy and all(gate["passed"] for gate in stored["gates"])


def status_table(counts: Mapping[Status, int], what: str = "capsules") -> pd.DataFrame:
    """Return how many ended with which status, the most frequent first."""
    rows = [(str(count), status.name, str(status)) for status, count in counts.items()]
    return table((what, "status", "what it means"), rows, numbers=(0,))


def summary_table(population: Population) -> pd.DataFrame:
    """Return median and quartiles of the medians of the usable capsules, and the error of one capsule."""
    rows = []
    for name, row in population.summary().iterrows():
        parameter = PARAMETERS[str(name)]
        numbers = [parameter.shown(row[key]) for key in ("median", "lower_quartile", "upper_quartile", "error")]
        middle, low, high, error = together(numbers, two_digits(numbers[-1]))
        rows.append((Symbols(parameter.label), middle, f"{low} to {high}", error))
    head = ("", "median", "quartiles", "error of one capsule, 68 %")
    return table(head, rows, title="Of the capsules that can be used", numbers=(1, 2, 3))


def hierarchy_table(stored: Mapping[str, Any]) -> pd.DataFrame:
    """Return medians, 68 and 95 % intervals of mean, spread and slope; `stored` is ``Hierarchy.as_dict()``."""
    rows = []
    for name, summary in stored["quantities"].items():
        parameter = PARAMETERS[name]
        numbers = [parameter.shown(summary[key]) for key in KINDS]
        middle, *ends = together(numbers, decimals(0.25 * (numbers[4] - numbers[3])))
        rows.append((Symbols(parameter.label), middle, " to ".join(ends[:2]), " to ".join(ends[2:])))
    head = ("", "median", "68 % interval", "95 % interval")
    return table(head, rows, title=hierarchy_title(stored), numbers=(1, 2, 3))


def capsule_table(population: Population, *, most: int) -> pd.DataFrame:
    """Return the capsules, worst first, at most so many."""
    shown = [name for name in SHOWN if f"{name}_median" in population.dataset]
    head = ["no.", "capsule", *(Symbols(PARAMETERS[name].label) for name in shown)]
    head[3:3] = [*(Symbols(f"{_MODULUS.symbol}: {level} % interval") for level in (68, 95)), "status"]
    names = population["name"] if "name" in population.dataset else np.full(len(population), "")
    summaries = {name: np.stack([population[f"{name}_{kind}"] for kind in KINDS], axis=1) for name in shown}
    statuses = population["status"]
    rows = []
    for rank, k in enumerate(population.worst_first()[:most], start=1):
        cells = [Number(str(rank), rank), str(names[k]) or str(k + 1)]
        cells += [_median(name, *summaries[name][k, :3]) for name in shown]
        intervals = (_interval(*summaries[_MODULUS.name][k, ends]) for ends in (slice(1, 3), slice(3, 5)))
        cells[3:3] = [*intervals, str(statuses[k])]
        rows.append(cells)
    return table(head, rows, numbers=(0, 2, 3, 4, *range(6, len(head))))


def origin_table(population: Population, source: str) -> pd.DataFrame:
    """Return file and attributes; the population itself has a table of its own."""
    attributes = {name: value for name, value in population.attributes.items() if name != "hierarchy"}
    lines = [*([("file", source)] if source else []), *flat(attributes)]
    rows = [(name, value if " " in value or len(value) <= _HASH else Code(value)) for name, value in lines]
    return table(("", ""), rows)


def _median(name: str, median: float, low: float, high: float) -> Number:
    if not np.isfinite(median):
        return Number("–", np.nan)
    shown = PARAMETERS[name].shown(median)
    return Number(together((shown,), _digits(name, median, low, high))[0], shown)


def _interval(low: float, high: float) -> Number:
    """An interval of G_s, sorted by the ratio of its ends."""
    if not np.isfinite(high - low):
        return Number("–", np.nan)
    digits = _digits(_MODULUS.name, low, low, 0.5 * (low + high))
    return Number(interval_words(_MODULUS.name, low, high, digits), high / low)


def _digits(name: str, median: float, low: float, high: float) -> int:
    """Decimals worth showing; three digits where no interval is known."""
    error = 0.5 * (high - low)
    return decimals(PARAMETERS[name].shown(error if np.isfinite(error) and error > 0.0 else 1e-3 * abs(median)))


def population_parts(population: Population) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of many capsules."""
    yield Strong(headline(population))
    yield width_words(population)
    yield status_words(population)
    yield p_value_words(population)
    yield status_table(population.counts)
    yield summary_table(population)


def hierarchy_parts(hierarchy: Hierarchy) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of the population that the capsules come from."""
    stored = hierarchy.as_dict()
    yield hierarchy_table(stored)
    yield spread_words(stored)
    yield update_words(stored)
    yield shared_words(stored)
    yield missing_words(stored)
    yield from caveats(stored)
