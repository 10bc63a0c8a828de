"""Figures of many capsules: the histogram of G_s, and G_s against a."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from capsbayes.parameters import PARAMETERS
from capsbayes.show.population_rows import MODULUS, RADIUS, column, done
from capsbayes.show.spread import Spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["modulus_against_radius", "modulus_histogram"]

_INK, _PALE, _DOUBT = "#1f5a7a", "#8fc1dc", "#c8552b"
_MOST_BARS = 400  # error bars of more capsules would hide each other
_MODULUS, _RADIUS = PARAMETERS[MODULUS], PARAMETERS[RADIUS]


def modulus_histogram(population: xr.Dataset, spread: Spread | None = None) -> Figure:
    """Draw the medians of G_s as a histogram, and over it the spread with the errors removed.

    Capsules whose intervals cannot be used are left out.

    Parameters
    ----------
    population : Dataset
    spread : Spread, optional

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(5.8, 3.6), layout="constrained")
    ax = figure.subplots()
    medians = column(population, MODULUS, "median")[done(population)]
    logs = np.log(medians[np.isfinite(medians)])
    edges = _edges(logs)
    counts, _ = np.histogram(logs, edges)
    shown = _MODULUS.scale * np.exp(edges)
    ax.stairs(counts, shown, fill=True, facecolor=_PALE, edgecolor=_INK, linewidth=1.0, label="medians, errors in them")
    if spread is not None and len(logs):
        _draw_spread(ax, spread, len(logs) * float(edges[1] - edges[0]), edges)
    _log_scale(ax, "x")
    ax.set_xlabel(_MODULUS.axis_label)
    ax.set_ylabel("capsules")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    ax.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=10)
    return figure


def modulus_against_radius(population: xr.Dataset) -> Figure:
    """Draw the median G_s of each capsule against its median radius, with 68 % intervals.

    Parameters
    ----------
    population : Dataset

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.8, 4.2), layout="constrained")
    ax = figure.subplots()
    use = done(population)
    bars = int(np.isfinite(column(population, MODULUS, "median")).sum()) <= _MOST_BARS
    for rows, colour, marker, face, label in (
        (use, _INK, "o", _INK, "intervals can be used"),
        (~use, _DOUBT, "s", "white", "did not end as it should"),
    ):
        x, y = (_with_errors(population, name, rows) for name in (RADIUS, MODULUS))
        seen = np.isfinite(x[0]) & np.isfinite(y[0])
        if not seen.any():
            continue
        errors = {"xerr": x[1][:, seen], "yerr": y[1][:, seen]} if bars else {}
        style = {"marker": marker, "linestyle": "none", "color": colour, "markerfacecolor": face, "markersize": 4.0}
        ax.errorbar(x[0][seen], y[0][seen], **errors, **style, elinewidth=0.7, alpha=0.85, label=label)  # type: ignore[arg-type]
    _log_scale(ax, "y")
    ax.set_xlabel(_RADIUS.axis_label)
    ax.set_ylabel(_MODULUS.axis_label)
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=10)
    return figure


def _edges(logs: np.ndarray) -> np.ndarray:
    """Edges of the bars in ln G_s: between 6 and 40 of them, by the rule of Freedman and Diaconis."""
    if not len(logs):
        return np.log([1e-3, 1.0])
    low, high = float(logs.min()), float(logs.max())
    quartiles = np.quantile(logs, [0.25, 0.75])
    width = 2.0 * float(quartiles[1] - quartiles[0]) / len(logs) ** (1.0 / 3.0)
    bars = int(np.clip(np.ceil((high - low) / width) if width > 0.0 else 1, 6, 40))
    margin = max(0.5 * (high - low) / bars, 0.005)
    return np.linspace(low - margin, high + margin, bars + 1)


def _draw_spread(ax: Axes, spread: Spread, area: float, edges: np.ndarray) -> None:
    """The normal distribution of ln G_s, in capsules to a bar, with its 95 % band."""
    reach = 3.0 * float(spread.relative[0])
    middle = float(np.log(spread.median[0]))
    modulus = np.exp(np.linspace(min(edges[0], middle - reach), max(edges[-1], middle + reach), 400))
    line, low, high = (area * one for one in spread.density(modulus))
    shown = _MODULUS.scale * modulus
    ax.plot(shown, line, color=_DOUBT, linewidth=1.8, label="errors removed")
    ax.fill_between(shown, low, high, color=_DOUBT, alpha=0.25, linewidth=0, label="its 95 % band")


def _with_errors(population: xr.Dataset, name: str, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Medians (n,) in the unit people read, and the distances (2, n) to the ends of the 68 % intervals."""
    scale = PARAMETERS[name].scale
    median, low, high = (scale * column(population, name, kind)[rows] for kind in ("median", "lower_68", "upper_68"))
    return median, np.nan_to_num(np.maximum(np.stack([median - low, high - median]), 0.0))


def _log_scale(ax: Axes, axis: str) -> None:
    """A logarithmic scale with plain numbers at its ticks, also where it spans less than a decade."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    (ax.set_xscale if axis == "x" else ax.set_yscale)("log")
    one = ax.xaxis if axis == "x" else ax.yaxis
    low, high = ax.get_xlim() if axis == "x" else ax.get_ylim()
    subs = (1.0, 2.0, 5.0) if high > 8.0 * low else tuple(np.arange(1.0, 10.0, 1.0 if high > 2.0 * low else 0.5))
    one.set_major_locator(LogLocator(subs=subs, numticks=12))
    one.set_major_formatter(StrMethodFormatter("{x:g}"))
    one.set_minor_formatter(NullFormatter())
