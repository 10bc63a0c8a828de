"""Sentences, tables and figures of plans: error budget, Sobol indices, flow rates for a known or unknown membrane."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.parameters import PARAMETERS
from capsbayes.plan import BudgetRow, ErrorBudget, FlowDesign, FlowPoint, MembraneFlowDesign, PlannedFlows, SobolStudy
from capsbayes.plan.membrane import MEASURED
from capsbayes.plan.widths import EACH, LOGARITHMIC
from capsbayes.report.numbers import per_cent, stated_in, unit_of, with_unit
from capsbayes.report.posterior import KEPT
from capsbayes.report.style import ACCENT, FILL, INK, PALE, WALL, framed, legend_below, new_figure, without_l
from capsbayes.report.tables import Symbols, table

_SPEED, _MODULUS = PARAMETERS["mean_velocity"], PARAMETERS["surface_shear_modulus"]
_COLOURS = {"surface_shear_modulus": INK, "capsule_radius": ACCENT}
_HEIGHT = 0.36  # of a bar
_LABEL = 42  # characters in a line of a label
_RARE = 0.005  # share of the capsules that is not mentioned
_ANSWERS = tuple(PARAMETERS[name] for name in ("surface_shear_modulus", "capsule_radius"))
_FLOW = ("mean_velocity", "flow_rate", "capsule_velocity", "capillary_number")


def flow_words(design: MembraneFlowDesign) -> Iterator[str]:
    """Yield what the flow rates tell, and which flow rates cannot be used."""
    if design.best is not None:
        yield _told_words(design)
    yield expected_words(design.membrane)
    yield from _limit_words(design)


def _told_words(design: MembraneFlowDesign) -> str:
    assert design.best is not None, "asked for"
    shares = {PARAMETERS[name].symbol: design.best.sds[name] / sd for name, sd in design.prior_sds.items()}
    told = [symbol for symbol, share in shares.items() if share <= KEPT]
    kept = [symbol for symbol, share in shares.items() if share > KEPT]
    speeds = ", ".join(f"{_SPEED.shown(speed):.3g}" for speed in design.best.mean_velocities)
    rates = ", ".join(f"{PARAMETERS['flow_rate'].shown(rate):.3g}" for rate in design.best.flow_rates)
    first = f"Film at U = {speeds} mm/s (Q = {rates} µL/min): G_s to ± {per_cent(design.best.sds[_MODULUS.name])}"
    parts = [f"{first}, were the membrane known to ± {per_cent(design.best.sd_if_known)}."]
    if shares:
        parts.append(f"The capsules tell {', '.join(told)}." if told else "The capsules tell nothing of the membrane.")
    if kept:
        parts.append(f"{', '.join(kept)} {'keeps its prior' if len(kept) == 1 else 'keep their priors'}.")
    return " ".join(parts)


def expected_words(membrane: Mapping[str, float]) -> str:
    """Say for which membrane an expectation holds."""
    numbers = ", ".join(f"{PARAMETERS[name].symbol} = {value:.3g}" for name, value in membrane.items())
    return f"This holds for capsules with about {numbers}; others tell more or less."


def _limit_words(design: MembraneFlowDesign) -> Iterator[str]:
    """Yield which velocities cannot be used, and why."""
    if design.limits is not None:
        low, high = design.limits
        yield (
            f"Slower than {with_unit('mean_velocity', low)}, more than {per_cent(design.risk)} of the capsules lie "
            "below the lowest Ca of the model, where the shape says little or snaps to another; faster than "
            f"{with_unit('mean_velocity', high)}, as many come nearer than {per_cent(design.margin)} in Ca to the "
            "highest, beyond which a steady shape may not exist."
        )
    if design.outside > _RARE:
        yield f"{per_cent(design.outside)} of the capsules have a size that the model does not have at any flow rate."
    for one in design.sets[-1:]:
        for speed in one.mean_velocities:
            risk = min(design.risks, key=lambda risk: abs(risk.mean_velocity - speed))
            lost = risk.without_shape - design.outside
            if lost > max(design.risk, _RARE):
                yield (
                    f"At U = {with_unit('mean_velocity', speed)} the model has no shape of {per_cent(lost)} of the "
                    "capsules; what is expected is of the others."
                )


def budget_table(budget: ErrorBudget) -> pd.DataFrame:
    """Return share, slope and change of G_s and of a for each input."""
    known = ((answer, with_unit(answer.name, budget.value[answer.name], ".4g")) for answer in _ANSWERS)
    values = ", ".join(f"{answer.symbol} = {value} ± {100.0 * budget.sd[answer.name]:.2g} %" for answer, value in known)
    columns = [(answer, what) for answer in _ANSWERS for what in ("share", "slope", "change")]
    head = ["input", *(Symbols(f"{answer.symbol}\n{what}") for answer, what in columns)]
    shares = {answer.name: budget.shares_of(answer.name) for answer in _ANSWERS}
    rows = []
    for row in budget.rows:
        cells = [cell for answer in _ANSWERS for cell in _cells(row, answer.name, shares[answer.name])]
        rows.append([Symbols(_input(row)), *cells])
    units = " and ".join(answer.shown_unit for answer in _ANSWERS)
    note = (
        "share: of the variance of the logarithm; slope: d ln / d ln of the input; change: with one standard error of "
        f"the input, in {units}"
    )
    for answer in _ANSWERS:
        note += "" if shares[answer.name] else f"; the shares of {answer.symbol} do not add up, and are omitted"
    return table(head, rows, title=f"Error budget: {values}", note=note, numbers=range(1, 7))


def sobol_table(study: SobolStudy) -> pd.DataFrame:
    """Return first-order and total index of each answer by each input."""
    rows = []
    for name, stated in study.ranges.items():
        indices = (f"{of[name].first:.2f}, {of[name].total:.2f}" for of in study.indices.values())
        rows.append([Symbols(f"{PARAMETERS[name].symbol} = {stated.shown(name)}"), *indices])
    errors = (max(max(index.first_error, index.total_error) for index in of.values()) for of in study.indices.values())
    rows.append(["95 %, at most", *(f"± {error:.2f}" for error in errors)])
    head = ["input", *(Symbols(PARAMETERS[answer].symbol) for answer in study.indices)]
    return table(head, rows, title="Sobol indices: alone, and with others", numbers=range(1, len(head)))


def flow_table(design: FlowDesign) -> pd.DataFrame:
    """Return some of the velocities, and the best."""
    rows = []
    for k, point in enumerate(design.points):
        if point is design.best or k % 12 == 11:
            numbers = [f"{PARAMETERS[name].shown(getattr(point, name)):.3g}" for name in _FLOW]
            widths = f"{point.relative:.1%}", f"{point.relative_radius:.1%}"
            risks = f"{point.leaning:.0%}", f"{point.beyond_limit:.1%}"
            rows.append([*numbers, *widths, *risks, "best" if point is design.best else "" if point.allowed else "no"])
    head = ["\n".join((PARAMETERS[name].symbol, unit_of(PARAMETERS[name]).strip())) for name in _FLOW]
    head += ["G_s\n±", "a\n±", "next to\nborder", "beyond\nlimit", ""]
    note = "no: not to be chosen, for the posterior leans on the border of the database, or it is too near the limit"
    return table(list(map(Symbols, head)), rows, title="Expected width of G_s", note=note, numbers=range(8))


def _input(row: BudgetRow) -> str:
    """An input with its value and error in the display unit."""
    if row.setting is None:
        return row.words
    scale, unit = stated_in(row.name, row.setting.unit)
    error = f" ± {scale * row.setting.error:.2g}" if row.setting.error else ""
    return f"{PARAMETERS[row.name].symbol} = {scale * row.setting.value:.4g}{error}{unit}"


def _cells(row: BudgetRow, quantity: str, shares: Mapping[str, float]) -> list[str]:
    slope, change = row.log_slope.get(quantity), row.change.get(quantity)
    return [
        f"{100.0 * shares[row.name]:.1f} %" if shares else "",
        "" if slope is None else f"{slope:+.3f}",
        "" if change is None else f"{PARAMETERS[quantity].shown(change):+.3g}",
    ]


def membrane_flow_table(design: MembraneFlowDesign) -> pd.DataFrame:
    """Return the sets of flow rates with the standard deviations that are expected, and those of the priors."""
    names = tuple(design.prior_sds)
    rows = [_row(str(len(one.mean_velocities)), one, names) for one in design.sets]
    if design.for_law is not None and design.for_law is not design.best:
        rows.append(_row(f"{len(design.for_law.mean_velocities)}, for the law", design.for_law, names))
    rows.append(["prior", "", "", "", "", "", *(f"{design.prior_sds[name]:.2g}" for name in names)])
    head = ["flow rates", f"U [{_SPEED.shown_unit}]", "Ca", "mean\nln G_s", "membrane\nknown", "ln G_s\nof each"]
    head += [_label(name) for name in names]
    batch = "one capsule, filmed" if design.same_capsule else f"{design.capsules} capsules, filmed in equal shares"
    title = f"Expected standard deviations: {batch} at the best flow rates"
    return table([Symbols(text) for text in head], rows, title=title, numbers=range(3, len(head)))


def membrane_map_table(quantiles: Mapping[str, Mapping[str, float]]) -> pd.DataFrame:
    """Return quantiles over a map of the standard deviations of ln G_s, by what is measured and known."""
    rows = []
    for name, levels in quantiles.items():
        known, kind = name.split("_")
        rows.append([MEASURED[kind], known, *(f"{level:.2g}" for level in levels.values())])
    head = ["measured", "membrane", "least", "quarter", "median", "three quarters", "most"]
    title = "Standard deviation of ln G_s of one capsule, over Ca and a/l"
    return table(head, rows, title=title, numbers=range(2, len(head)))


def _row(name: str, one: PlannedFlows, parameters: tuple[str, ...]) -> list[str]:
    speeds = " ".join(f"{_SPEED.shown(speed):.2g}" for speed in one.mean_velocities)
    numbers = " ".join(f"{ca:.2g}" for ca in one.capillary_numbers)
    widths = [one.sds["surface_shear_modulus"], one.sd_if_known, one.sds[EACH], *(one.sds[key] for key in parameters)]
    return [name, speeds, numbers, *(f"{width:.2g}" for width in widths)]


def _label(name: str) -> str:
    symbol = PARAMETERS[name].symbol
    return f"ln {symbol}" if name in LOGARITHMIC else symbol


def membrane_flow_parts(design: MembraneFlowDesign) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of the flow rates at which a batch is to be filmed."""
    if design.sets:
        yield membrane_flow_table(design)
    yield from flow_words(design)


def budget_figure(budget: ErrorBudget) -> Figure:
    """Draw the shares of the variance of G_s and a, and next to them the change of each with one standard error."""
    figure = new_figure(9.6, 1.6 + 0.42 * len(budget.rows))
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(budget.rows), dtype=float)
    for shift, (quantity, colour) in zip((-0.5, 0.5), _COLOURS.items(), strict=True):
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
    table = design.table()
    speed = _SPEED.scale * table["mean_velocity"].to_numpy()
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
        ax.axvline(_SPEED.scale * design.limit_velocity, color=ACCENT, linewidth=1.2, linestyle="--")
    if design.best is not None:
        _mark_best(upper, design.best)
    _label_axes(upper, lower, design, width)
    return figure


def _mark_best(ax: Axes, best: FlowPoint) -> None:
    ax.plot(_SPEED.shown(best.mean_velocity), 100.0 * best.relative, "o", color=INK, markersize=8)
    speed, rate = with_unit("mean_velocity", best.mean_velocity), with_unit("flow_rate", best.flow_rate)
    accuracy = f"$G_\\mathrm{{s}}$ to ± {100.0 * best.relative:.2g} %"
    ax.set_title(f"best: $U$ = {speed}, $Q$ = {rate}, {accuracy}", fontsize=11)


def _label_axes(upper: Axes, lower: Axes, design: FlowDesign, width: Floats) -> None:
    first = design.points[0]
    per = PARAMETERS["flow_rate"].shown(first.flow_rate) / _SPEED.shown(first.mean_velocity)
    upper.set_xscale("log")
    above: Any = upper.secondary_xaxis("top", functions=(partial(np.multiply, per), partial(np.multiply, 1.0 / per)))
    above.set_xlabel(PARAMETERS["flow_rate"].axis_label)
    for axis in (upper.xaxis, above.xaxis):
        _plain_numbers(axis)
    low, high = (_SPEED.shown(design.points[end].mean_velocity) for end in (0, -1))
    label = "expected half of the 68 %\ninterval of $G_\\mathrm{s}$ [%]"
    upper.set(xlim=(0.92 * low, 1.08 * high), ylim=(0.0, 1.08 * float(np.nanmax(width))), ylabel=label)
    lower.set(xlabel=_SPEED.axis_label, ylabel="capsules [%]", ylim=(-4.0, 104.0))
    for ax in (upper, lower):
        framed(ax, ("right",)).legend(frameon=False, fontsize=9, loc="upper left" if ax is lower else "lower left")


def _plain_numbers(axis: Axis) -> None:
    """Plain numbers at the ticks of a logarithmic axis, at 2 and 5 between the decades too."""
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")


def membrane_flow_figure(design: MembraneFlowDesign) -> Figure:
    """Draw the best sets of flow rates with what they tell, and the capsules that cannot be used at each velocity."""
    figure = new_figure(7.4, 5.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    planned = [(flows, "o-", INK, 7, "") for flows in design.sets]
    if design.for_law is not None and design.for_law is not design.best:
        planned.append((design.for_law, "s--", ACCENT, 6, "\n(for the law)"))
    labels = []
    for place, (flows, line, colour, size, note) in enumerate(planned):
        speeds = _SPEED.scale * np.array(flows.mean_velocities)
        upper.plot(speeds, np.full(len(speeds), place), line, color=colour, markersize=size)
        labels.append(f"{len(speeds)}: ± {100.0 * flows.sds[_MODULUS.name]:.2g} %{note}")
    upper.set_yticks(range(len(labels)), labels)
    upper.set(ylabel=f"flow rates: ${_MODULUS.latex}$ to", ylim=(len(labels) - 0.5, -0.5))
    speed = _SPEED.scale * np.array([risk.mean_velocity for risk in design.risks])
    for name, colour, width, label in (
        ("without_shape", FILL, 6.0, "without a shape in the model"),
        ("below", INK, 1.4, "below the lowest Ca of the model"),
        ("beyond_margin", ACCENT, 1.4, f"above the highest, or nearer to it than {100.0 * design.margin:g} %"),
    ):
        shares = [100.0 * getattr(risk, name) for risk in design.risks]
        lower.plot(speed, shares, color=colour, linewidth=width, label=label)
    lower.axhline(100.0 * design.risk, color="black", linewidth=0.8, linestyle=":")
    lower.set(xscale="log", xlabel=_SPEED.axis_label, ylabel="capsules [%]", ylim=(-4.0, 104.0))
    _plain_numbers(lower.xaxis)
    framed(lower).legend(frameon=False, fontsize=9, loc="upper center")
    framed(upper).grid(axis="x", color=PALE, linewidth=0.5)
    return figure
