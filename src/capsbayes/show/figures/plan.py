"""Figures of the plan of an experiment: error budget, Sobol indices, and the flow rate to choose."""

from __future__ import annotations

from functools import partial
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capsbayes.parameters import PARAMETERS
from capsbayes.plan import BudgetRow, ErrorBudget, FlowDesign, SobolStudy
from capsbayes.show.figures.style import ACCENT, INK, PALE, WALL, framed, legend_below, new_figure, without_l
from capsbayes.show.words.rounding import with_unit

_QUANTITIES = {"surface_shear_modulus": INK, "capsule_radius": ACCENT}
_HEIGHT = 0.36  # of a bar
_LABEL = 42  # characters in a line of a label


def budget_figure(budget: ErrorBudget) -> Figure:
    """Draw the shares of the variance of G_s and a, and next to them the change of each with one standard error."""
    figure = new_figure(9.6, 1.6 + 0.42 * len(budget.rows))
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(budget.rows), dtype=float)
    for shift, (quantity, colour) in zip((-0.5, 0.5), _QUANTITIES.items(), strict=True):
        share_of = budget.shares_of(quantity)
        shares = [100.0 * share_of.get(row.name, np.nan) for row in budget.rows]
        changes = [100.0 * row.change.get(quantity, np.nan) / budget.value[quantity] for row in budget.rows]
        value = with_unit(quantity, budget.value[quantity])
        label = f"${PARAMETERS[quantity].latex}$ = {value} ± {100.0 * budget.sd[quantity]:.2g} %"
        for ax, lengths, digits in ((left, shares, ".0f"), (right, changes, "+.1f")):
            bars = ax.barh(places + shift * _HEIGHT, lengths, _HEIGHT, color=colour, label=label)
            words = [f"{length:{digits}}" if np.isfinite(length) else "" for length in lengths]
            ax.bar_label(bars, words, padding=2, fontsize=8)
    left.set_yticks(places, [_input_label(row) for row in budget.rows])
    left.invert_yaxis()
    for ax in (left, right):
        ax.margins(x=0.14)
    _frame_bars(left, "share of the variance of the logarithm [%]")
    _frame_bars(right, "change with one standard error of the input [%]")
    legend_below(figure, left, 2)
    return figure


def _input_label(row: BudgetRow) -> str:
    parameter = PARAMETERS.get(row.name)
    words = row.words if parameter is None else f"${without_l(row.name)}$, {parameter.meaning}"
    return fill(words, _LABEL)


def _frame_bars(ax: Axes, label: str) -> None:
    """Axes of horizontal bars: a line at zero, no frame."""
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set_xlabel(label)
    framed(ax, ("top", "right", "left")).tick_params(axis="y", length=0)


def sobol_figure(study: SobolStudy, answers: tuple[str, ...] = ("surface_shear_modulus", "capsule_radius")) -> Figure:
    """Draw the first-order and total indices of some answers, with their 95 % confidence intervals."""
    figure = new_figure(4.2 * len(answers) + 1.2, 1.9 + 0.45 * len(study.ranges))
    axes = figure.subplots(1, len(answers), sharey=True, squeeze=False)[0]
    for ax, answer in zip(axes, answers, strict=True):
        _bars(ax, study, answer)
    names = [f"${without_l(name)}$" for name in study.ranges]
    axes[0].set_yticks(np.arange(len(names)), names)
    axes[0].invert_yaxis()
    legend_below(figure, axes[0], 2)
    return figure


def _bars(ax: Axes, study: SobolStudy, answer: str) -> None:
    indices = list(study.indices[answer].values())
    places = np.arange(len(indices), dtype=float)
    style: dict[str, Any] = {"error_kw": {"elinewidth": 1.0, "ecolor": "#333333"}, "capsize": 2.0}
    first, first_error = np.array([[index.first, index.first_error] for index in indices]).T
    total, total_error = np.array([[index.total, index.total_error] for index in indices]).T
    for shift, values, errors, colour, label in (
        (-0.5, first, first_error, INK, "alone (first order)"),
        (0.5, total, total_error, PALE, "with others (total)"),
    ):
        ax.barh(places + shift * _HEIGHT, values, _HEIGHT, xerr=errors, color=colour, label=label, **style)
    relative = 100.0 * study.sd[answer] / study.mean[answer]
    ax.set_title(f"${PARAMETERS[answer].latex}$: sd {relative:.2g} % over the ranges", fontsize=10)
    ax.set_xlim(min(0.0, 1.1 * float(np.min(first - first_error))), None)
    _frame_bars(ax, "Sobol index")


def flow_figure(design: FlowDesign) -> Figure:
    """Draw the expected width over the mean velocity, with the flow rate above, and the risk below."""
    figure = new_figure(7.4, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    table, velocity = design.table(), PARAMETERS["mean_velocity"]
    speed = velocity.scale * table["mean_velocity"].to_numpy()
    allowed = table["allowed"].to_numpy()
    width = 100.0 * table["relative"].to_numpy()
    upper.plot(speed, width, color=WALL, linewidth=1.2, label="leans on the border of the database, or too near")
    upper.plot(speed, np.where(allowed, width, np.nan), color=INK, linewidth=2.2, label="may be chosen")
    limit = "the limit of existence" if design.limit.limit else "the end of the database"
    for name, colour, line, label in (
        ("beyond_margin", INK, 1.2, f"nearer to it than {100.0 * design.margin:g} % in Ca"),
        ("beyond_limit", ACCENT, 1.6, f"beyond {limit}"),
    ):
        lower.plot(speed, 100.0 * table[name].to_numpy(), color=colour, linewidth=line, label=label)
    lower.axhline(100.0 * design.risk, color="black", linewidth=0.8, linestyle=":")
    for ax in (upper, lower):
        ax.axvline(velocity.scale * design.limit_velocity, color=ACCENT, linewidth=1.2, linestyle="--")
    _mark_best(upper, design)
    _label_axes(upper, lower, design, width)
    return figure


def _mark_best(ax: Axes, design: FlowDesign) -> None:
    if design.best is None:
        return
    best = design.best
    ax.plot(PARAMETERS["mean_velocity"].shown(best.mean_velocity), 100.0 * best.relative, "o", color=INK, markersize=8)
    speed, rate = with_unit("mean_velocity", best.mean_velocity), with_unit("flow_rate", best.flow_rate)
    accuracy = f"$G_\\mathrm{{s}}$ to ± {100.0 * best.relative:.2g} %"
    ax.set_title(f"best: $U$ = {speed}, $Q$ = {rate}, {accuracy}", fontsize=11)


def _label_axes(upper: Axes, lower: Axes, design: FlowDesign, width: np.ndarray) -> None:
    first = design.points[0]
    per = PARAMETERS["flow_rate"].shown(first.flow_rate) / PARAMETERS["mean_velocity"].shown(first.mean_velocity)
    upper.set_xscale("log")
    above: Any = upper.secondary_xaxis("top", functions=(partial(np.multiply, per), partial(np.multiply, 1.0 / per)))
    above.set_xlabel(PARAMETERS["flow_rate"].axis_label)
    for axis in (upper.xaxis, above.xaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    ends = [PARAMETERS["mean_velocity"].shown(design.points[end].mean_velocity) for end in (0, -1)]
    upper.set(
        xlim=(0.92 * ends[0], 1.08 * ends[1]),
        ylabel="expected half of the 68 %\ninterval of $G_\\mathrm{s}$ [%]",
        ylim=(0.0, 1.08 * float(np.nanmax(width))),
    )
    lower.set(xlabel=PARAMETERS["mean_velocity"].axis_label, ylabel="capsules [%]", ylim=(-4.0, 104.0))
    for ax in (upper, lower):
        framed(ax, ("right",)).legend(frameon=False, fontsize=9, loc="upper left" if ax is lower else "lower left")
