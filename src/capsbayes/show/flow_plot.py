"""The flow rate to choose as a picture: expected width of G_s and the risk of no steady shape, over the velocity."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.parameters import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from capsbayes.plan import FlowDesign

__all__ = ["flow_figure"]

_INK, _SEEN, _GREY = "#1f5a7a", "#c8552b", "#9a9a9a"


def flow_figure(design: FlowDesign) -> Figure:
    """Draw the expected width over the mean velocity, with the flow rate above, and the risk below.

    Parameters
    ----------
    design : FlowDesign

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    table, velocity = design.table(), PARAMETERS["mean_velocity"]
    speed = velocity.scale * table["mean_velocity"].to_numpy()
    allowed = table["allowed"].to_numpy()
    width = 100.0 * table["relative"].to_numpy()
    upper.plot(speed, width, color=_GREY, linewidth=1.2, label="leans on the border of the database, or too near")
    upper.plot(speed, np.where(allowed, width, np.nan), color=_INK, linewidth=2.2, label="may be chosen")
    lower.plot(speed, 100.0 * table["beyond_margin"].to_numpy(), color=_INK, linewidth=1.2, label=_margin(design))
    lower.plot(
        speed, 100.0 * table["beyond_limit"].to_numpy(), color=_SEEN, linewidth=1.6, label=f"beyond {_limit(design)}"
    )
    lower.axhline(100.0 * design.risk, color="black", linewidth=0.8, linestyle=":")
    for ax in (upper, lower):
        ax.axvline(velocity.scale * design.limit_velocity, color=_SEEN, linewidth=1.2, linestyle="--")
    _mark_best(upper, design)
    _finish(upper, lower, design, width)
    return figure


def _mark_best(ax: Axes, design: FlowDesign) -> None:
    if design.best is None:
        return
    best, velocity, rate = design.best, PARAMETERS["mean_velocity"], PARAMETERS["flow_rate"]
    ax.plot(velocity.shown(best.mean_velocity), 100.0 * best.relative, "o", color=_INK, markersize=8)
    ax.set_title(
        f"best: $U$ = {velocity.shown(best.mean_velocity):.3g} mm/s, $Q$ = {rate.shown(best.flow_rate):.3g} µL/min, "
        f"$G_\\mathrm{{s}}$ to ± {100.0 * best.relative:.2g} %",
        fontsize=11,
    )


def _finish(upper: Axes, lower: Axes, design: FlowDesign, width: np.ndarray) -> None:
    first = design.points[0]
    per = PARAMETERS["flow_rate"].shown(first.flow_rate) / PARAMETERS["mean_velocity"].shown(first.mean_velocity)
    upper.set_xscale("log")
    above: Any = upper.secondary_xaxis("top", functions=(_times(per), _times(1.0 / per)))
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
        ax.spines[["right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=9, loc="upper left" if ax is lower else "lower left")


def _times(factor: float) -> Callable[[Any], Any]:
    return lambda values: factor * np.asarray(values)


def _limit(design: FlowDesign) -> str:
    return "the limit of existence" if design.limit.limit else "the end of the database"


def _margin(design: FlowDesign) -> str:
    return f"nearer to it than {100.0 * design.margin:g} % in Ca"
