"""Figures and page of many capsules: the histogram of G_s, G_s against a, and the table, worst first."""

from __future__ import annotations

import base64

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.infer.hierarchy import ModulusSpread
from capsbayes.infer.population import Population
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.report import population as texts
from capsbayes.report.numbers import counted, with_unit
from capsbayes.report.page import page
from capsbayes.report.posterior import membrane_words
from capsbayes.report.style import ACCENT, INK, PALE, framed, legend_below, new_plot, plain_numbers

USABLE, OTHERS = "usable-capsules", "other-capsules"
"""Ids of the points of `modulus_against_radius`, which are in the order of the population."""
_MOST_BARS = 400  # error bars of more capsules would hide each other
_MODULUS, _RADIUS = PARAMETERS["surface_shear_modulus"], PARAMETERS["capsule_radius"]
MOST_ROWS = 500
"""Capsules in the table of the page; the file holds all."""
_MOST_MARKS = 500  # points; a picture of pixels is smaller than more


def modulus_histogram(population: Population, spread: ModulusSpread | None = None) -> Figure:
    """Draw the medians of G_s of the usable capsules, and over them the spread with the errors removed."""
    figure, ax = new_plot(5.0, 3.4)
    edges, counts = _bars(population)
    shown = _MODULUS.scale * np.exp(edges)
    ax.stairs(counts, shown, fill=True, facecolor=PALE, edgecolor=INK, linewidth=1.0, label="medians, errors in them")
    for number, count in enumerate(counts):  # unseen, to be pointed at
        ax.bar(shown[number], count, np.diff(shown)[number], align="edge", color=INK, alpha=0.002, gid=f"bar-{number}")
    if spread is not None and counts.any():
        _draw_spread(ax, spread, counts.sum() * float(edges[1] - edges[0]), edges)
    ax.set_xscale("log")
    plain_numbers(ax.xaxis)
    ax.set(xlabel=_MODULUS.axis_label, ylabel="capsules")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    legend_below(figure, framed(ax), 2)
    return figure


def _bars(population: Population) -> tuple[Floats, Integers]:
    """Edges in ln G_s of 6 to 40 bars by the rule of Freedman and Diaconis, and the usable capsules in each."""
    medians = population[f"{_MODULUS.name}_median"][population.usable]
    logs = np.log(medians[np.isfinite(medians)])
    if not len(logs):
        return np.log([1e-3, 1.0]), np.zeros(1, dtype=int)
    low, high = float(logs.min()), float(logs.max())
    quartiles = np.quantile(logs, [0.25, 0.75])
    width = 2.0 * float(quartiles[1] - quartiles[0]) / len(logs) ** (1.0 / 3.0)
    bars = int(np.clip(np.ceil((high - low) / width) if width > 0.0 else 1, 6, 40))
    margin = max(0.5 * (high - low) / bars, 0.005)
    edges = np.linspace(low - margin, high + margin, bars + 1)
    return edges, np.histogram(logs, edges)[0]


def bar_words(population: Population) -> dict[str, list[str]]:
    """What each bar of the histogram says, by its ``gid``."""
    edges, counts = _bars(population)
    ends = _MODULUS.scale * np.exp(edges)
    everyone = counted(counts.sum(), "capsule")
    return {
        f"bar-{k}": [f"{ends[k]:.3g} to {ends[k + 1]:.3g} {_MODULUS.shown_unit}: {count} of {everyone}"]
        for k, count in enumerate(counts)
        if count
    }


def modulus_against_radius(population: Population) -> Figure:
    """Draw the median G_s of each capsule against its median radius, with 68 % intervals."""
    figure, ax = new_plot(5.0, 4.0)
    use = population.usable
    bars = int(np.isfinite(population[f"{_MODULUS.name}_median"]).sum()) <= _MOST_BARS
    for rows, colour, marker, face, label in (
        (use, INK, "o", INK, "intervals can be used"),
        (~use, ACCENT, "s", "white", "intervals cannot be used"),
    ):
        x, y = (_with_errors(population, parameter, rows) for parameter in (_RADIUS, _MODULUS))
        seen = np.isfinite(x[0]) & np.isfinite(y[0])
        if not seen.any():
            continue
        errors = {"xerr": x[1][:, seen], "yerr": y[1][:, seen]} if bars else {}
        style = {"marker": marker, "linestyle": "none", "color": colour, "markerfacecolor": face, "markersize": 4.0}
        drawn = ax.errorbar(x[0][seen], y[0][seen], **errors, **style, elinewidth=0.7, alpha=0.85, label=label)  # type: ignore[arg-type]
        drawn.lines[0].set_gid(USABLE if marker == "o" else OTHERS)
    ax.set_yscale("log")
    plain_numbers(ax.yaxis)
    ax.set(xlabel=_RADIUS.axis_label, ylabel=_MODULUS.axis_label)
    framed(ax)
    if ax.get_legend_handles_labels()[0]:
        legend_below(figure, ax, 1)
    return figure


def _draw_spread(ax: Axes, spread: ModulusSpread, area: float, edges: Floats) -> None:
    """The distribution of ln G_s that was fitted, in capsules to a bar, with its 95 % band."""
    reach = 3.0 * float(spread.relative[0])
    middle = float(np.log(spread.median[0]))
    modulus = np.exp(np.linspace(min(edges[0], middle - reach), max(edges[-1], middle + reach), 400))
    line, low, high = (area * density for density in spread.density(modulus))
    shown = _MODULUS.scale * modulus
    ax.plot(shown, line, color=ACCENT, linewidth=1.8, label="errors removed")
    ax.fill_between(shown, low, high, color=ACCENT, alpha=0.25, linewidth=0, label="its 95 % band")


def _with_errors(population: Population, parameter: Parameter, rows: Booleans) -> tuple[Floats, Floats]:
    """Medians (n,) in the display unit, and the distances (2, n) to the ends of the 68 % intervals."""
    median, low, high = (
        parameter.scale * population[f"{parameter.name}_{kind}"][rows] for kind in ("median", "lower_68", "upper_68")
    )
    return median, np.nan_to_num(np.maximum(np.stack([median - low, high - median]), 0.0))


def population_page(
    population: Population, *, spread: ModulusSpread | None = None, rows: int = MOST_ROWS, source: str = ""
) -> str:
    """Return a population as a page in HTML, with at most `rows` capsules in the table, all in the file `source`."""
    stored = population.attributes.get("hierarchy")
    drawn = spread or ModulusSpread.of_population(population)
    figures = (modulus_histogram, bar_words, modulus_against_radius, point_words)
    return page(
        "population.html",
        population=population,
        texts=texts,
        stored=stored,
        distribution=spread or stored or drawn,
        spread=drawn,
        membrane=membrane_words(str(population.attributes.get("model", "that was used"))),
        most=rows,
        most_marks=_MOST_MARKS,
        source=source,
        csv=_csv(population, rows),
        **{function.__name__: function for function in figures},
    )


def point_words(population: Population) -> dict[str, list[str]]:
    """Return what each point of G_s against a says, by the id of its group."""
    names = ("surface_shear_modulus", "capsule_radius")
    drawn = np.isfinite(np.stack([population[f"{name}_median"] for name in names])).all(axis=0)
    titles = population["name"] if "name" in population.dataset else np.arange(1, len(population) + 1)
    words = {}
    for group, chosen in ((USABLE, population.usable), (OTHERS, ~population.usable)):
        words[group] = [
            f"{titles[k]}: " + ", ".join(with_unit(name, float(population[f"{name}_median"][k])) for name in names)
            for k in np.flatnonzero(drawn & chosen)
        ]
    return words


def _csv(population: Population, most: int) -> str:
    """Return the summaries of the capsules in the table of the page, in SI, as the address of a CSV file."""
    numbers = (f"{name}_{kind}" for name in texts.SHOWN[:4] for kind in texts.KINDS)
    along = [name for name in ("name", "status", *numbers) if name in population.dataset]
    shown = population.dataset[along].isel(capsule=population.worst_first()[:most])
    text = "".join(Population(shown).lines())
    return f"data:text/csv;base64,{base64.b64encode(text.encode()).decode()}"
