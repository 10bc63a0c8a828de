"""The capsule in its channel: predicted outline with its band, and the lengths that were measured."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capsbayes.errors import InputError
from capsbayes.infer import Posterior
from capsbayes.infer.outline import aligned_with, band
from capsbayes.measurement import MID_PLANE
from capsbayes.show.figures.style import ACCENT, INK, PALE, WALL, closed, draw_walls, framed, new_figure

_INSIDE = "#f3f8fb"
_THICKNESS = 0.14
_DIMENSION_LINE = 1.36  # height of the arrow of L_z, over l
_TOP = 1.8  # of the picture, over l


def outline_figure(posterior: Posterior, *, width: float = 7.4) -> Figure:
    """Draw `outline_plot` alone on a figure of a width [inch] that fits it."""
    left, right, bottom, top = 0.75, 0.2, 1.0, 0.7
    figure = new_figure(width, width, layout=None)
    ax = outline_plot(posterior, figure.add_axes((0.1, 0.1, 0.8, 0.8)))
    (z_low, z_high), (y_low, y_high) = ax.get_xlim(), ax.get_ylim()
    wide = width - left - right
    high = wide * (y_high - y_low) / (z_high - z_low)
    height = high + bottom + top
    figure.set_size_inches(width, height)
    ax.set_position((left / width, bottom / height, wide / width, high / height))
    return figure


def outline_plot(posterior: Posterior, ax: Axes) -> Axes:
    """Draw the predicted outline between the walls, lengths over l, with a scale in micrometres.

    The line is the mean outline, the band holds 95 % of the posterior along
    the normal. The points of a measured outline are shifted and turned onto
    it. The measured lengths are arrows that start at the predicted
    nose; their ends are shaded over two standard errors either side.

    Raises
    ------
    InputError
        If the model predicts no outlines.
    """
    if posterior.outlines is None:
        raise InputError("outline_plot", "posterior", "a posterior with outlines", f"none from {posterior.model_name}")
    middle, inner, outer = band(posterior.outlines)
    nose = float(middle[:, 0].max())
    ends = (float(middle[:, 0].min()) - 0.55, nose + 0.55)
    draw_walls(ax, ends, 1.0 + _THICKNESS, color=None, facecolor="#e6e6e6", edgecolor=WALL, hatch="////")
    for side in (-1.0, 1.0):
        ax.plot(ends, [side, side], color="#555555", linewidth=1.2)
    ax.fill(*closed(outer).T, color=PALE, linewidth=0, label="95 % of the posterior", zorder=2)
    ax.fill(*closed(inner).T, color=_INSIDE, linewidth=0, zorder=2.1)
    seen = posterior.measurement.outline
    shown = "outline" if seen is None or seen.view == MID_PLANE else seen.view
    ax.plot(*closed(middle).T, color=INK, linewidth=1.6, label=f"predicted {shown}", zorder=3)
    if seen is not None:
        measured, _ = aligned_with(seen.points, middle)
        ax.plot(*measured.T, ".", color=ACCENT, markersize=2.0, label="measured outline", zorder=4)
    _draw_lengths(ax, posterior, nose)
    _finish(ax, posterior, ends)
    return ax


def _draw_lengths(ax: Axes, posterior: Posterior, nose: float) -> None:
    measured = posterior.measurement
    scale = 1.0 if measured.over_half_width else posterior.inputs.half_width.value
    lines = [("z", measured.axial_extent, measured.axial_extent_error, _DIMENSION_LINE)]
    if measured.axial_length is not None and measured.axial_length_error is not None:
        lines.append(("a", measured.axial_length, measured.axial_length_error, 0.0))
    arrow = {"arrowstyle": "<|-|>", "color": ACCENT, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
    for symbol, length, error, height in lines:
        length, error = length / scale, error / scale
        rear, ends = nose - length, [height - 0.09, height + 0.09]
        ax.annotate("", (rear, height), (nose, height), arrowprops=arrow, zorder=5)
        label = "measured, ±2 standard errors" if height else None
        shade: dict[str, Any] = {"color": ACCENT, "alpha": 0.3, "linewidth": 0, "zorder": 4, "label": label}
        ax.fill_betweenx(ends, rear - 2 * error, rear + 2 * error, **shade)
        text = rf"$L_{{\mathrm{{{symbol}}}}}/\ell = {length:.3f} \pm {error:.3f}$"
        middle = nose - 0.5 * length, height + 0.05
        ax.text(*middle, text, color=ACCENT, ha="center", va="bottom", fontsize=12, zorder=6)
    for z, low in ((nose, 0.0), (nose - measured.axial_extent / scale, -0.2)):
        ax.plot([z, z], [low, _DIMENSION_LINE + 0.06], ":", color=ACCENT, linewidth=1.0, zorder=1.5)


def _finish(ax: Axes, posterior: Posterior, ends: tuple[float, float]) -> None:
    """Label the axes and say the direction of the flow and the medians."""
    micrometres = 1e6 * posterior.inputs.half_width.value
    arrow = {"arrowstyle": "-|>", "color": "#555555"}
    flow = {"va": "center", "ha": "right", "fontsize": 11, "color": "#555555", "arrowprops": arrow}
    ax.annotate("flow", (ends[1] - 0.1, -0.72), (ends[1] - 0.5, -0.72), **flow)  # type: ignore[arg-type]
    ax.set(xlim=ends, ylim=(-1.0 - _THICKNESS, _TOP), aspect="equal", xlabel=r"$z/\ell$", ylabel=r"$y/\ell$")
    ax.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    to_micrometres = partial(np.multiply, micrometres), partial(np.multiply, 1.0 / micrometres)
    top = ax.secondary_xaxis("top", functions=to_micrometres)
    top.set_xlabel(rf"$z$ [µm], for $\ell$ = {micrometres:.3g} µm")
    framed(ax, ("right",))
    ca, size = posterior.marginals["capillary_number"], posterior.marginals["size_ratio"]
    text = rf"medians: $\mathrm{{Ca}} = {ca.median:.4f}$, $a/\ell = {size.median:.3f}$"
    ax.text(ends[0] + 0.05, _TOP - 0.05, text, va="top", fontsize=11)
    handles, labels = ax.get_legend_handles_labels()
    order = [1, 0, *range(2, len(handles))]  # the line before its band
    spacing, handle, size_of_text = (1.5, 1.6, 10) if len(order) < 4 else (1.0, 1.2, 8.5)
    ax.legend(
        [handles[k] for k in order],
        [labels[k] for k in order],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.075),
        ncols=len(order),
        frameon=False,
        columnspacing=spacing,
        handlelength=handle,
        fontsize=size_of_text,
    )
