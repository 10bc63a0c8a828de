"""The capsule in its channel: predicted outline with its band, and the lengths that were measured."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.infer import Posterior
from capsbayes.infer.outline.likelihood import aligned_with
from capsbayes.measured_outline import MID_PLANE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["band", "outline_figure", "outline_plot"]

Floats = NDArray[np.float64]

_INK, _BAND, _INSIDE, _SEEN, _WALL = "#1f5a7a", "#8fc1dc", "#f3f8fb", "#c8552b", "#9a9a9a"
_WALL_THICKNESS = 0.14
_DIMENSION_LINE = 1.36  # height of the arrow of L_z, over l
_TOP = 1.8  # of the picture, over l


def outline_figure(posterior: Posterior, *, width: float = 7.4) -> Figure:
    """Draw `outline_plot` alone on a figure that fits it.

    Parameters
    ----------
    posterior : Posterior
    width : float [inch]

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    left, right, bottom, top = 0.75, 0.2, 1.0, 0.7
    figure = Figure(figsize=(width, width))
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

    Parameters
    ----------
    posterior : Posterior
    ax : Axes

    Returns
    -------
    Axes

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
    _draw_walls(ax, ends)
    closed = [np.concatenate([line, line[:1]]) for line in (middle, inner, outer)]
    ax.fill(*closed[2].T, color=_BAND, linewidth=0, label="95 % of the posterior", zorder=2)
    ax.fill(*closed[1].T, color=_INSIDE, linewidth=0, zorder=2.1)
    seen = posterior.measurement.outline
    shown = "outline" if seen is None or seen.view == MID_PLANE else seen.view
    ax.plot(*closed[0].T, color=_INK, linewidth=1.6, label=f"predicted {shown}", zorder=3)
    if seen is not None:
        measured, _ = aligned_with(seen.points, middle)
        ax.plot(*measured.T, ".", color=_SEEN, markersize=2.0, label="measured outline", zorder=4)
    _draw_lengths(ax, posterior, nose)
    _finish(ax, posterior, ends)
    return ax


def band(outlines: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean outline and the 2.5 % and 97.5 % quantiles of the distance from it along its normal.

    Parameters
    ----------
    outlines : (d, p, 2) array
        Corresponding points, columns (z, y), counter-clockwise.

    Returns
    -------
    middle, inner, outer : (p, 2) arrays
    """
    middle = outlines.mean(axis=0)
    tangent = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.hypot(*tangent.T)[:, None]
    distance = np.einsum("dpk,pk->dp", outlines - middle, normal)
    low, high = np.quantile(distance, [0.025, 0.975], axis=0)
    return middle, middle + low[:, None] * normal, middle + high[:, None] * normal


def _draw_walls(ax: Axes, ends: tuple[float, float]) -> None:
    for side in (-1.0, 1.0):
        ax.fill_between(
            ends, side, side * (1.0 + _WALL_THICKNESS), facecolor="#e6e6e6", edgecolor=_WALL, hatch="////", linewidth=0
        )
        ax.plot(ends, [side, side], color="#555555", linewidth=1.2)


def _draw_lengths(ax: Axes, posterior: Posterior, nose: float) -> None:
    seen = posterior.measurement
    scale = 1.0 if seen.over_half_width else posterior.inputs.half_width.value
    lines = [("L_z", seen.axial_extent, seen.axial_extent_error, _DIMENSION_LINE)]
    if seen.axial_length is not None and seen.axial_length_error is not None:
        lines.append(("L_a", seen.axial_length, seen.axial_length_error, 0.0))
    for symbol, length, error, height in lines:
        rear, error = nose - length / scale, error / scale
        half = 0.09
        ax.annotate(
            "",
            (rear, height),
            (nose, height),
            arrowprops={"arrowstyle": "<|-|>", "color": _SEEN, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0},
            zorder=5,
        )
        ax.fill_betweenx(
            [height - half, height + half],
            rear - 2 * error,
            rear + 2 * error,
            color=_SEEN,
            alpha=0.3,
            linewidth=0,
            zorder=4,
            label="measured, ±2 standard errors" if height else None,
        )
        text = rf"$L_{{\mathrm{{{symbol[-1]}}}}}/\ell = {length / scale:.3f} \pm {error:.3f}$"
        ax.text(
            nose - 0.5 * length / scale,
            height + 0.05,
            text,
            color=_SEEN,
            ha="center",
            va="bottom",
            fontsize=12,
            zorder=6,
        )
    extent = seen.axial_extent / scale
    for z in (nose, nose - extent):
        ax.plot(
            [z, z], [0.0 if z == nose else -0.2, _DIMENSION_LINE + 0.06], ":", color=_SEEN, linewidth=1.0, zorder=1.5
        )


def _finish(ax: Axes, posterior: Posterior, ends: tuple[float, float]) -> None:
    micrometres = 1e6 * posterior.inputs.half_width.value
    ax.annotate(
        "flow",
        (ends[1] - 0.1, -0.72),
        (ends[1] - 0.5, -0.72),
        va="center",
        ha="right",
        fontsize=11,
        arrowprops={"arrowstyle": "-|>", "color": "#555555"},
        color="#555555",
    )
    ax.set(xlim=ends, ylim=(-1.0 - _WALL_THICKNESS, _TOP), aspect="equal")
    ax.set_xlabel(r"$z/\ell$")
    ax.set_ylabel(r"$y/\ell$")
    ax.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    top = ax.secondary_xaxis(
        "top", functions=(partial(np.multiply, micrometres), partial(np.multiply, 1.0 / micrometres))
    )
    top.set_xlabel(rf"$z$ [µm], for $\ell$ = {micrometres:.3g} µm")
    ax.spines["right"].set_visible(False)
    ca, size = posterior.marginals["capillary_number"], posterior.marginals["size_ratio"]
    text = rf"medians: $\mathrm{{Ca}} = {ca.median:.4f}$, $a/\ell = {size.median:.3f}$"
    ax.text(ends[0] + 0.05, _TOP - 0.05, text, va="top", fontsize=11)
    handles, labels = ax.get_legend_handles_labels()
    order = [1, 0, *range(2, len(handles))]  # the line before its band
    ax.legend(
        [handles[k] for k in order],
        [labels[k] for k in order],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.075),
        ncols=len(order),
        frameon=False,
        columnspacing=1.5 if len(order) < 4 else 1.0,
        handlelength=1.6 if len(order) < 4 else 1.2,
        fontsize=10 if len(order) < 4 else 8.5,
    )
