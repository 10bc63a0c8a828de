"""Figure of the membrane that a batch shares: G_s flow by flow, and the lengths as predicted and as measured."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.infer.prior import Marginal
from capsbayes.infer.shared_membrane import SharedMembrane
from capsbayes.parameters import PARAMETERS
from capsbayes.show.figures.style import ACCENT, INK, PALE, WALL, framed, legend_below, new_figure, ratio_label

_MARKERS = "osD^v"
_COLOURS = (INK, ACCENT, PALE, WALL)
_MODULUS, _SPEED = PARAMETERS["surface_shear_modulus"], PARAMETERS["mean_velocity"]


def membrane_figure(shared: SharedMembrane) -> Figure:
    """Draw the mean G_s of the capsules of each flow under each law, and predicted against measured lengths."""
    figure = new_figure(9.0, 4.2)
    left, right = figure.subplots(1, 2)
    _draw_flows(left, shared)
    _draw_lengths(right, shared)
    legend_below(figure, framed(left), 4, fontsize=9)
    return figure


def _draw_flows(ax: Axes, shared: SharedMembrane) -> None:
    flows = range(int(shared.flow.max()) + 1)
    speeds = np.array([_SPEED.shown(float(np.median(shared.speed[shared.flow == k]))) for k in flows])
    rows = [("membrane unknown", shared.moduli_by_flow())]
    rows += [(law.name, shared.moduli_by_flow(law.draws)) for law in shared.laws[1:] if law.usable]
    for number, (name, marginals) in enumerate(rows):
        aside = 1.0 + 0.03 * (number - 0.5 * (len(rows) - 1))  # so that bars do not hide each other
        colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
        middles, errors = _with_errors(marginals)
        ax.errorbar(
            speeds * aside, middles, errors, color=colour, marker=marker, linestyle="none", markersize=5, label=name
        )
    ax.set(xscale="log", yscale="log", xlabel="speed of the flow [mm/s]", ylabel=_MODULUS.axis_label)
    ax.set_xticks(speeds, [f"{speed:.3g}" for speed in speeds])
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("{x:g}")
    ax.minorticks_off()
    low, high = ax.get_ylim()
    ticks = np.geomspace(low * 1.05, high / 1.05, 5)
    ax.set_yticks(ticks, [f"{tick:.2g}" for tick in ticks])
    ax.set_title("mean of the capsules of each flow, 68 %", fontsize=10)


def _draw_lengths(ax: Axes, shared: SharedMembrane) -> None:
    for column, (name, colour, marker) in enumerate((("axial_extent", INK, "o"), ("axial_length", ACCENT, "s"))):
        measured, predicted = shared.lengths[:, column], np.median(shared.draws[f"{name}_each"], axis=0)
        ax.plot(
            predicted,
            measured,
            color=colour,
            marker=marker,
            linestyle="none",
            markersize=4,
            alpha=0.8,
            label=f"${PARAMETERS[name].latex}$",
        )
    ends = ax.get_xlim()
    ax.plot(ends, ends, color=WALL, linewidth=1.0, zorder=0)
    ax.set(xlim=ends, xlabel="predicted", ylabel="measured")
    ax.set_title(f"{ratio_label('axial_extent')} and {ratio_label('axial_length')}", fontsize=10)
    framed(ax).legend(frameon=False)


def _with_errors(marginals: list[Marginal]) -> tuple[Floats, Floats]:
    middles = np.array([_MODULUS.shown(one.median) for one in marginals])
    ends = np.array([[_MODULUS.shown(end) for end in one.ends(68)] for one in marginals]).T
    return middles, np.abs(ends - middles)
