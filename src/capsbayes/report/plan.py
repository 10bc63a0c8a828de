"""Plans: error budget, Sobol indices, flow rates, and maps of what a measurement tells, in sentences and figures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.path import Path

from capsbayes.arrays import Floats
from capsbayes.infer.verdict import LEANING_SHARE
from capsbayes.parameters import PARAMETERS
from capsbayes.plan import ErrorBudget, FlowDesign, MembraneFlowDesign, PlannedFlows, SobolStudy
from capsbayes.plan.membrane import KNOWN, MEASURED, UNKNOWN
from capsbayes.plan.widths import EACH, LOGARITHMIC
from capsbayes.report import style
from capsbayes.report.numbers import counted, per_cent, stated_in, unit_of, with_unit
from capsbayes.report.posterior import told_words
from capsbayes.report.style import ACCENT, FILL, INK, PALE, WALL
from capsbayes.report.tables import Symbols, table

_SPEED, _RATE, _MODULUS = (PARAMETERS[name] for name in ("mean_velocity", "flow_rate", "surface_shear_modulus"))
_HEIGHT = 0.36  # of a bar
_LABEL = 42  # characters in a line of a label
_RARE = 0.005  # share of the capsules that is not mentioned
_ANSWERS = (_MODULUS, PARAMETERS["capsule_radius"])
_FLOW = ("mean_velocity", "flow_rate", "capsule_velocity", "capillary_number")
_LEVELS = np.outer(np.logspace(-2, 5, 8), (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0)).ravel().round(9)  # %
_TICKS = (0.003, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def membrane_flow_parts(design: MembraneFlowDesign) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of the flow rates at which a batch is to be filmed."""
    if design.sets:
        yield membrane_flow_table(design)
    if design.best is not None:
        yield _best_words(design, design.best)
    yield expected_words(design.membrane)
    yield from _limit_words(design)


def _best_words(design: MembraneFlowDesign, best: PlannedFlows) -> str:
    speeds = ", ".join(f"{_SPEED.shown(speed):.3g}" for speed in best.mean_velocities)
    rates = ", ".join(f"{_RATE.shown(rate):.3g}" for rate in best.flow_rates)
    known = f"G_s to ± {per_cent(best.sds[_MODULUS.name])}, were the membrane known to ± {per_cent(best.sd_if_known)}."
    words = f"Film at U = {speeds} mm/s (Q = {rates} µL/min): {known}"
    shares = {name: best.sds[name] / sd for name, sd in design.prior_sds.items()}
    return f"{words} {told_words(shares, 'keeps its prior', 'keep their priors')}" if shares else words


def expected_words(membrane: Mapping[str, float]) -> str:
    """Say for which membrane an expectation holds."""
    numbers = ", ".join(f"{PARAMETERS[name].symbol} = {value:.3g}" for name, value in membrane.items())
    return f"This holds for capsules with about {numbers}; others tell more or less."


def _limit_words(design: MembraneFlowDesign) -> Iterator[str]:
    """Yield which velocities cannot be used, and why."""
    if design.limits is not None:
        low, high = (with_unit(_SPEED.name, limit) for limit in design.limits)
        yield (
            f"Slower than {low}, more than {per_cent(design.risk)} of the capsules lie below the lowest Ca of the "
            f"model, where the shape says little or snaps to another; faster than {high}, as many come nearer than "
            f"{per_cent(design.margin)} in Ca to the highest, beyond which a steady shape may not exist."
        )
    if design.outside > _RARE:
        yield f"{per_cent(design.outside)} of the capsules have a size that the model does not have at any flow rate."
    for speed in design.sets[-1].mean_velocities if design.sets else ():
        risk = min(design.risks, key=lambda risk: abs(risk.mean_velocity - speed))
        lost = risk.without_shape - design.outside
        if lost > max(design.risk, _RARE):
            yield (
                f"At U = {with_unit(_SPEED.name, speed)} the model has no shape of {per_cent(lost)} of the capsules; "
                "what is expected is of the others."
            )


def budget_table(budget: ErrorBudget) -> pd.DataFrame:
    """Return share, slope and change of G_s and of a for each input."""
    shares = {answer.name: budget.shares_of(answer.name) for answer in _ANSWERS}
    rows = []
    for row in budget.rows:
        cells: list[str] = [Symbols(row.words)]
        if row.setting is not None:
            scale, unit = stated_in(row.name, row.setting.unit)
            error = f" ± {scale * row.setting.error:.2g}" if row.setting.error else ""
            cells = [Symbols(f"{PARAMETERS[row.name].symbol} = {scale * row.setting.value:.4g}{error}{unit}")]
        for answer in _ANSWERS:
            slope, change, known = row.log_slope.get(answer.name), row.change.get(answer.name), shares[answer.name]
            cells.append(f"{100.0 * known[row.name]:.1f} %" if known else "")
            cells.append("" if slope is None else f"{slope:+.3f}")
            cells.append("" if change is None else f"{answer.shown(change):+.3g}")
        rows.append(cells)
    head = ["input", *(f"{answer.symbol}\n{what}" for answer in _ANSWERS for what in ("share", "slope", "change"))]
    units = " and ".join(answer.shown_unit for answer in _ANSWERS)
    note = (
        "share: of the variance of the logarithm; slope: d ln / d ln of the input; change: with one standard error of "
        f"the input, in {units}"
    )
    values = []
    for answer in _ANSWERS:
        value = with_unit(answer.name, budget.value[answer.name], ".4g")
        values.append(f"{answer.symbol} = {value} ± {100.0 * budget.sd[answer.name]:.2g} %")
        note += "" if shares[answer.name] else f"; the shares of {answer.symbol} do not add up, and are omitted"
    title = f"Error budget: {', '.join(values)}"
    return table(list(map(Symbols, head)), rows, title=title, note=note, numbers=range(1, 7))


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


def membrane_flow_table(design: MembraneFlowDesign) -> pd.DataFrame:
    """Return the sets of flow rates with the standard deviations that are expected, and those of the priors."""
    names = tuple(design.prior_sds)
    planned = [(str(len(flows.mean_velocities)), flows) for flows in design.sets]
    if design.for_law is not None and design.for_law is not design.best:
        planned.append((f"{len(design.for_law.mean_velocities)}, for the law", design.for_law))
    rows = []
    for count, flows in planned:
        speeds = " ".join(f"{_SPEED.shown(speed):.2g}" for speed in flows.mean_velocities)
        numbers = " ".join(f"{ca:.2g}" for ca in flows.capillary_numbers)
        sds = [flows.sds[_MODULUS.name], flows.sd_if_known, *(flows.sds[name] for name in (EACH, *names))]
        rows.append([count, speeds, numbers, *(f"{sd:.2g}" for sd in sds)])
    rows.append(["prior", "", "", "", "", "", *(f"{design.prior_sds[name]:.2g}" for name in names)])
    head = ["flow rates", f"U [{_SPEED.shown_unit}]", "Ca", "mean\nln G_s", "membrane\nknown", "ln G_s\nof each"]
    head += [f"{'ln ' * (name in LOGARITHMIC)}{PARAMETERS[name].symbol}" for name in names]
    several = f"{counted(design.capsules, 'capsule')}, filmed in equal shares"
    batch = "one capsule, filmed" if design.same_capsule else several
    title = f"Expected standard deviations: {batch} at the best flow rates"
    return table(list(map(Symbols, head)), rows, title=title, numbers=range(3, len(head)))


def membrane_map_table(quantiles: Mapping[str, Mapping[str, float]]) -> pd.DataFrame:
    """Return quantiles over a map of the standard deviations of ln G_s, by what is measured and known."""
    rows = []
    for name, levels in quantiles.items():
        known, kind = name.split("_")
        rows.append([MEASURED[kind], known, *(f"{level:.2g}" for level in levels.values())])
    head = ["measured", "membrane", "least", "quarter", "median", "three quarters", "most"]
    title = "Standard deviation of ln G_s of one capsule, over Ca and a/l"
    return table(head, rows, title=title, numbers=range(2, len(head)))


def budget_figure(budget: ErrorBudget) -> Figure:
    """Draw the shares of the variance of G_s and a, and next to them the change of each with one standard error."""
    figure = style.new_figure(9.6, 1.6 + 0.42 * len(budget.rows))
    left, right = figure.subplots(1, 2, sharey=True)
    for shift, answer, colour in zip((-0.5, 0.5), _ANSWERS, (INK, ACCENT), strict=True):
        value, share_of = budget.value[answer.name], budget.shares_of(answer.name)
        shares = [100.0 * share_of.get(row.name, np.nan) for row in budget.rows]
        changes = [100.0 * row.change.get(answer.name, np.nan) / value for row in budget.rows]
        error = f"± {100.0 * budget.sd[answer.name]:.2g} %"
        label = f"${answer.latex}$ = {with_unit(answer.name, value)} {error}"
        for ax, lengths, digits in ((left, shares, ".0f"), (right, changes, "+.1f")):
            bars = _draw_bars(ax, shift, lengths, color=colour, label=label)
            words = [f"{length:{digits}}" if np.isfinite(length) else "" for length in lengths]
            ax.bar_label(bars, words, padding=2, fontsize=8)
            ax.margins(x=0.14)
    _frame_bars(left, "share of the variance of the logarithm [%]")
    _frame_bars(right, "change with one standard error of the input [%]")
    named = {row.name: PARAMETERS.get(row.name) for row in budget.rows}
    inputs = {name: f"${style.without_l(name)}$, {known.meaning}" for name, known in named.items() if known is not None}
    _name_bars(left, [fill(inputs.get(row.name, row.words), _LABEL) for row in budget.rows])
    style.legend_below(figure, left, 2)
    return figure


def sobol_figure(study: SobolStudy, answers: tuple[str, ...] = ("surface_shear_modulus", "capsule_radius")) -> Figure:
    """Draw the first-order and total indices of some answers, with their 95 % confidence intervals."""
    figure = style.new_figure(4.2 * len(answers) + 1.2, 1.9 + 0.45 * len(study.ranges))
    axes = figure.subplots(1, len(answers), sharey=True, squeeze=False)[0]
    whiskers: dict[str, Any] = {"error_kw": {"elinewidth": 1.0, "ecolor": "#333333"}, "capsize": 2.0}
    for ax, answer in zip(axes, answers, strict=True):
        indices = study.indices[answer].values()
        first, first_error = np.array([[index.first, index.first_error] for index in indices]).T
        total, total_error = np.array([[index.total, index.total_error] for index in indices]).T
        _draw_bars(ax, -0.5, first, xerr=first_error, color=INK, label="alone (first order)", **whiskers)
        _draw_bars(ax, 0.5, total, xerr=total_error, color=PALE, label="with others (total)", **whiskers)
        relative = 100.0 * study.sd[answer] / study.mean[answer]
        ax.set_title(f"${PARAMETERS[answer].latex}$: sd {relative:.2g} % over the ranges", fontsize=10)
        ax.set_xlim(min(0.0, 1.1 * float(np.min(first - first_error))), None)
        _frame_bars(ax, "Sobol index")
    _name_bars(axes[0], [f"${style.without_l(name)}$" for name in study.ranges])
    style.legend_below(figure, axes[0], 2)
    return figure


def _draw_bars(ax: Axes, shift: float, lengths: Sequence[float] | Floats, **look: Any) -> BarContainer:
    """Horizontal bars, one a row, shifted by a share of their height."""
    return ax.barh(np.arange(len(lengths)) + shift * _HEIGHT, lengths, _HEIGHT, **look)


def _frame_bars(ax: Axes, label: str) -> None:
    """Axes of horizontal bars: a line at zero, no frame."""
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set_xlabel(label)
    style.framed(ax, ("top", "right", "left")).tick_params(axis="y", length=0)


def _name_bars(ax: Axes, names: list[str]) -> None:
    """Name the rows of bars, from above."""
    ax.set_yticks(np.arange(len(names)), names)
    ax.invert_yaxis()


def flow_figure(design: FlowDesign) -> Figure:
    """Draw the expected width over the mean velocity, with the flow rate above, and the risk below."""
    figure = style.new_figure(7.4, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    table = design.table()
    speed, width = _SPEED.scale * table["mean_velocity"].to_numpy(), 100.0 * table["relative"].to_numpy()
    chosen = np.where(table["allowed"], width, np.nan)
    upper.plot(speed, width, color=WALL, linewidth=1.2, label="leans on the border of the database, or too near")
    upper.plot(speed, chosen, color=INK, linewidth=2.2, label="may be chosen")
    limit = "the limit of existence" if design.limit.limit else "the end of the database"
    near = f"nearer to it than {100.0 * design.margin:g} % in Ca"
    lower.plot(speed, 100.0 * table["beyond_margin"], color=INK, linewidth=1.2, label=near)
    lower.plot(speed, 100.0 * table["beyond_limit"], color=ACCENT, linewidth=1.6, label=f"beyond {limit}")
    _frame_risks(lower, design.risk)
    for ax in (upper, lower):
        ax.axvline(_SPEED.scale * design.limit_velocity, color=ACCENT, linewidth=1.2, linestyle="--")
    if (best := design.best) is not None:
        upper.plot(_SPEED.shown(best.mean_velocity), 100.0 * best.relative, "o", color=INK, markersize=8)
        flow = f"$U$ = {with_unit('mean_velocity', best.mean_velocity)}, $Q$ = {with_unit('flow_rate', best.flow_rate)}"
        upper.set_title(f"best: {flow}, $G_\\mathrm{{s}}$ to ± {100.0 * best.relative:.2g} %", fontsize=11)
    upper.set_xscale("log")
    above = style.second_scale(upper, _RATE.shown(design.points[0].flow_rate) / speed[0])
    above.set_xlabel(_RATE.axis_label)
    style.plain_numbers(upper.xaxis, above.xaxis)
    label = "expected half of the 68 %\ninterval of $G_\\mathrm{s}$ [%]"
    upper.set(xlim=(0.92 * speed[0], 1.08 * speed[-1]), ylim=(0.0, 1.08 * float(np.nanmax(width))), ylabel=label)
    style.framed(upper, ("right",)).legend(frameon=False, fontsize=9, loc="lower left")
    style.framed(lower, ("right",)).legend(frameon=False, fontsize=9, loc="upper left")
    return figure


def _frame_risks(ax: Axes, risk: float) -> None:
    """Axes of shares of the capsules over the velocity, with the share that is allowed."""
    ax.axhline(100.0 * risk, color="black", linewidth=0.8, linestyle=":")
    ax.set(xlabel=_SPEED.axis_label, ylabel="capsules [%]", ylim=(-4.0, 104.0))


def membrane_flow_figure(design: MembraneFlowDesign) -> Figure:
    """Draw the best sets of flow rates with what they tell, and the capsules that cannot be used at each velocity."""
    figure = style.new_figure(7.4, 5.2)
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
    _frame_risks(lower, design.risk)
    lower.set_xscale("log")
    style.plain_numbers(lower.xaxis)
    style.framed(lower).legend(frameon=False, fontsize=9, loc="upper center")
    style.framed(upper).grid(axis="x", color=PALE, linewidth=0.5)
    return figure


# Maps: contours of the width of G_s or a over (Ca, a/l) within the border of the model


def identifiability_figure(widths: xr.Dataset, quantity: str = "surface_shear_modulus") -> Figure:
    """Draw the relative width of G_s or a over (Ca, a/l)."""
    # Hatched is where the posterior leans on the border of the model, so that its width is cut and not measured; below
    # the dotted line two steady shapes are stable.
    figure, ax = style.new_plot(7.4, 5.6)
    width = 100.0 * widths[f"width_of_{quantity}"].to_numpy()
    leaning, two_shapes = widths["leaning"].to_numpy(), widths["two_shapes"].to_numpy()
    levels = _levels(width)
    areas, lines, clip = _draw_map(ax, widths, width, levels, 0.7)
    plane = widths["capillary_number"].to_numpy(), widths["size_ratio"].to_numpy()
    hatched: dict[str, Any] = {"levels": [LEANING_SHARE, 1.1], "colors": "none", "hatches": ["////"]}
    ax.contourf(*plane, _filled(leaning), **hatched).set_clip_path(clip)
    dotted: dict[str, Any] = {"colors": ACCENT, "linestyles": "dotted", "linewidths": 1.6}
    ax.contour(*plane, _filled(two_shapes.astype(float)), levels=[0.5], **dotted).set_clip_path(clip)
    labels, inside = ax.clabel(lines, fmt=lambda value: f"{value:g} %", fontsize=8), Path(clip.get_xy())
    style.outlined(labels)
    for text in labels:
        text.set_visible(inside.contains_point(text.get_position()))
    _frame_map(ax, clip)
    label = f"half of the 68 % interval of ${PARAMETERS[quantity].latex}$ over its median [%]"
    figure.colorbar(areas, ax=ax, label=label, ticks=levels, format="{x:g}")
    words = "leans on the border of the database: cut there, not measured"
    marks: list[Any] = [Patch(facecolor="none", hatch="////", label=words)]
    if two_shapes.any():
        line: dict[str, Any] = {"color": ACCENT, "linestyle": "dotted", "linewidth": 1.6}
        marks.append(Line2D([], [], label="left of it two shapes are stable", **line))
    style.legend_below(figure, marks, 2, fontsize=9)
    ax.set_title(_error_words(widths), fontsize=10)
    return figure


def membrane_map_figure(widths: xr.Dataset) -> Figure:
    """Draw the standard deviation of ln G_s of one capsule, with the membrane unknown and known, within its border."""
    panels = [(kind, known) for kind in MEASURED for known in (UNKNOWN, KNOWN) if f"{UNKNOWN}_{kind}" in widths]
    figure = style.new_figure(8.6, 1.0 + 1.5 * len(panels))
    axes = figure.subplots(len(panels) // 2, 2, sharex=True, sharey=True, squeeze=False)
    shown = [100.0 * widths[f"{known}_{kind}"].to_numpy() for kind, known in panels]
    levels = _levels(np.stack(shown))
    for ax, sds, (kind, known) in zip(axes.flat, shown, panels, strict=True):
        areas, _, clip = _draw_map(ax, widths, sds, levels, 0.6)
        _frame_map(ax, clip)
        ax.set_title(f"{MEASURED[kind]}, membrane {known}", fontsize=10)
    for ax in axes.flat:
        ax.label_outer()
    label = f"standard deviation of $\\ln {_MODULUS.latex}$ [%]"
    figure.colorbar(areas, ax=axes, label=label, ticks=levels, format="{x:g}")
    return figure


def _draw_map(
    ax: Axes, widths: xr.Dataset, shown: Floats, levels: list[float], line: float
) -> tuple[Any, Any, Polygon]:
    """Draw contours within the border of the model: the areas, the lines, and the border, which clips them."""
    ca, size = widths["capillary_number"].to_numpy(), widths["size_ratio"].to_numpy()
    sides = [np.stack([widths[end].to_numpy(), size], axis=1) for end in ("lowest", "highest")]
    border = np.concatenate([sides[0], sides[1][::-1]])
    border = border[np.isfinite(border).all(axis=1)]
    clip = Polygon(border, closed=True, fill=False, edgecolor="black", linewidth=1.8, zorder=3)
    ax.add_patch(clip)
    look: dict[str, Any] = {"norm": LogNorm(levels[0], levels[-1]), "cmap": "viridis_r"}
    areas = ax.contourf(ca, size, _filled(shown), levels=levels, **look)
    lines = ax.contour(ca, size, _filled(shown), levels=levels, colors="white", linewidths=line)
    for drawn in (areas, lines):
        drawn.set_clip_path(clip)
    return areas, lines, clip


def _frame_map(ax: Axes, border: Polygon) -> None:
    """Axes as wide as the border."""
    ax.set_xscale("log")
    (left, bottom), (right, top) = border.get_xy().min(axis=0), border.get_xy().max(axis=0)
    margin = 0.03 * (top - bottom)
    ax.set(xlim=(0.93 * left, 1.07 * right), ylim=(bottom - margin, top + margin))
    style.label_plane(ax, _TICKS)


def _levels(shown: Floats) -> list[float]:
    """Levels from below the smallest number that is shown to above the largest."""
    known = shown[np.isfinite(shown)] if np.isfinite(shown).any() else np.ones(1)
    below, above = (int(np.searchsorted(_LEVELS, end, "right")) for end in (known.min(), known.max()))
    return _LEVELS[below - 1 : above + 1].tolist()


def _filled(values: Floats) -> Floats:
    """Values carried on along Ca beyond the border, where the picture is cut."""
    return pd.DataFrame(values).interpolate(axis=1, limit_direction="both").to_numpy()


def _error_words(widths: xr.Dataset) -> str:
    """Model and errors in two lines."""
    stated, lab = (json.loads(widths.attrs[name]) for name in ("errors", "experiment"))
    scale, unit = (1.0, r"$\ell$") if stated["unit_of_lengths"] == "l" else (1e6, "µm")
    length = "not measured" if stated["axial_length"] is None else f"± {scale * stated['axial_length']:.3g} {unit}"
    share = {name: 100.0 * lab[name]["error"] / lab[name]["value"] for name in ("viscosity", "half_width")}
    return (
        f"{widths.attrs['model']}; errors: $L_z$ ± {scale * stated['axial_extent']:.3g} {unit}, $L_a$ {length}, "
        f"$v_\\mathrm{{o}}$ ± {100.0 * stated['capsule_velocity_relative']:.2g} %,\n"
        f"$\\mu$ ± {share['viscosity']:.2g} %, $\\ell$ ± {share['half_width']:.2g} %"
    )
