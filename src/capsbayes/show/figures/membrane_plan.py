"""Figures of the plan of measurements whose membrane is unknown: the flow rates of a batch."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from capsbayes.parameters import PARAMETERS
from capsbayes.plan import MembraneFlowDesign
from capsbayes.show.figures.style import ACCENT, FILL, INK, PALE, framed, new_figure

_SPEED, _MODULUS = PARAMETERS["mean_velocity"], PARAMETERS["surface_shear_modulus"]


def membrane_flow_figure(design: MembraneFlowDesign) -> Figure:
    """Draw the best sets of flow rates with what they tell, and the capsules that cannot be used at each velocity."""
    figure = new_figure(7.4, 5.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for place, one in enumerate(design.sets):
        speeds = _SPEED.scale * np.array(one.mean_velocities)
        upper.plot(speeds, np.full(len(speeds), place), "o-", color=INK, markersize=7)
    lawful = design.for_law
    if lawful is not None and lawful is not design.best:
        speeds = _SPEED.scale * np.array(lawful.mean_velocities)
        upper.plot(speeds, np.full(len(speeds), len(design.sets)), "s--", color=ACCENT, markersize=6)
    shown = [*design.sets, *([] if lawful is None or lawful is design.best else [lawful])]
    labels = [f"{len(one.mean_velocities)}: ± {100.0 * one.sds[_MODULUS.name]:.2g} %" for one in shown]
    if len(shown) > len(design.sets):
        labels[-1] += "\n(for the law)"
    upper.set_yticks(range(len(shown)), labels)
    upper.set(ylabel=f"flow rates: ${_MODULUS.latex}$ to", ylim=(len(shown) - 0.5, -0.5))
    speed = _SPEED.scale * np.array([risk.mean_velocity for risk in design.risks])
    lines = (
        ("without_shape", FILL, 6.0, "without a shape in the model"),
        ("below", INK, 1.4, "below the lowest Ca of the model"),
        ("beyond_margin", ACCENT, 1.4, f"above the highest, or nearer to it than {100.0 * design.margin:g} %"),
    )
    for name, colour, width, label in lines:
        shares = [100.0 * getattr(risk, name) for risk in design.risks]
        lower.plot(speed, shares, color=colour, linewidth=width, label=label)
    lower.axhline(100.0 * design.risk, color="black", linewidth=0.8, linestyle=":")
    lower.set(xscale="log", xlabel=_SPEED.axis_label, ylabel="capsules [%]", ylim=(-4.0, 104.0))
    lower.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    lower.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    framed(lower).legend(frameon=False, fontsize=9, loc="upper center")
    framed(upper).grid(axis="x", color=PALE, linewidth=0.5)
    return figure
