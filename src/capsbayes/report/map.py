"""Maps of what a measurement tells: contours of the width of G_s or a over (Ca, a/l) within the border of the model."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.path import Path

from capsbayes.arrays import Floats
from capsbayes.infer.verdict import LEANING_SHARE
from capsbayes.parameters import PARAMETERS
from capsbayes.plan.membrane import KNOWN, MEASURED, UNKNOWN
from capsbayes.report.style import ACCENT, label_plane, legend_below, new_figure, outlined

_LEVELS = (
    *(0.2, 0.5, 0.7, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0),
    *(10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 70.0, 100.0, 150.0),
)  # %
_TICKS = (0.003, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def identifiability_figure(widths: xr.Dataset, quantity: str = "surface_shear_modulus") -> Figure:
    """Draw the relative width of G_s or a over (Ca, a/l).

    Hatched is where the posterior leans on the border of the model, so that its width is cut and not measured; below
    the dotted line two steady shapes are stable.
    """
    figure = new_figure(7.4, 5.6)
    ax = figure.subplots()
    width = 100.0 * widths[f"width_of_{quantity}"].to_numpy()
    leaning, two_shapes = widths["leaning"].to_numpy(), widths["two_shapes"].to_numpy()
    levels = _levels(np.where(leaning <= LEANING_SHARE, width, np.nan))
    areas, lines, clip = _draw(ax, widths, width, levels, 0.7)
    plane = widths["capillary_number"].to_numpy(), widths["size_ratio"].to_numpy()
    of_border: dict[str, Any] = {"levels": [LEANING_SHARE, 1.1], "colors": "none", "hatches": ["////"]}
    ax.contourf(*plane, _filled(leaning), **of_border).set_clip_path(clip)
    dotted: dict[str, Any] = {"colors": ACCENT, "linestyles": "dotted", "linewidths": 1.6}
    ax.contour(*plane, _filled(two_shapes.astype(float)), levels=[0.5], **dotted).set_clip_path(clip)
    inside = Path(clip.get_xy())
    labels = ax.clabel(lines, fmt=lambda value: f"{value:g} %", fontsize=8)
    outlined(labels)
    for text in labels:
        text.set_visible(inside.contains_point(text.get_position()))
    _finish(ax, clip.get_xy())
    label = f"half of the 68 % interval of ${PARAMETERS[quantity].latex}$ over its median [%]"
    _draw_bar(figure, areas, ax, label, levels)
    marks: list[Any] = [
        Patch(facecolor="none", hatch="////", label="leans on the border of the database: cut there, not measured")
    ]
    if two_shapes.any():
        style: dict[str, Any] = {"color": ACCENT, "linestyle": "dotted", "linewidth": 1.6}
        marks.append(Line2D([], [], label="left of it two shapes are stable", **style))
    legend_below(figure, marks, 2, fontsize=9)
    ax.set_title(_errors(widths), fontsize=10)
    return figure


def membrane_map_figure(widths: xr.Dataset) -> Figure:
    """Draw the standard deviation of ln G_s of one capsule, with the membrane unknown and known, within its border."""
    kinds = [kind for kind in MEASURED if f"{UNKNOWN}_{kind}" in widths]
    figure = new_figure(8.6, 1.0 + 3.0 * len(kinds))
    axes = figure.subplots(len(kinds), 2, sharex=True, sharey=True, squeeze=False)
    names = [f"{known}_{kind}" for kind in kinds for known in (UNKNOWN, KNOWN)]
    levels = _levels(100.0 * np.stack([widths[name].to_numpy() for name in names]))
    for ax, name in zip(axes.flat, names, strict=True):
        areas, _, clip = _draw(ax, widths, 100.0 * widths[name].to_numpy(), levels, 0.6)
        _finish(ax, clip.get_xy())
        known, kind = name.split("_")
        ax.set_title(f"{MEASURED[kind]}, membrane {known}", fontsize=10)
    for ax in axes.flat:
        ax.label_outer()
    _draw_bar(
        figure, areas, axes, f"standard deviation of $\\ln {PARAMETERS['surface_shear_modulus'].latex}$ [%]", levels
    )
    return figure


def _draw(ax: Axes, widths: xr.Dataset, shown: Floats, levels: list[float], line: float) -> tuple[Any, Any, Polygon]:
    """Draw contours within the border of the model: the areas, the lines, and the border, which clips them."""
    border = _border(widths)
    clip = Polygon(border, closed=True, fill=False, edgecolor="black", linewidth=1.8, zorder=3)
    ax.add_patch(clip)
    plane = widths["capillary_number"].to_numpy(), widths["size_ratio"].to_numpy(), _filled(shown)
    style: dict[str, Any] = {"norm": LogNorm(levels[0], levels[-1]), "cmap": "viridis_r", "extend": "both"}
    areas = ax.contourf(*plane, levels=levels, **style)
    lines = ax.contour(*plane, levels=levels, colors="white", linewidths=line)
    for drawn in (areas, lines):
        drawn.set_clip_path(clip)
    return areas, lines, clip


def _finish(ax: Axes, border: Floats) -> None:
    """Axes as wide as the border."""
    ax.set_xscale("log")
    low, high = border.min(axis=0), border.max(axis=0)
    margin = 0.03 * (high[1] - low[1])
    ax.set(xlim=(0.93 * low[0], 1.07 * high[0]), ylim=(low[1] - margin, high[1] + margin))
    label_plane(ax, _TICKS)


def _draw_bar(figure: Figure, areas: Any, axes: Any, label: str, levels: list[float]) -> None:
    bar = figure.colorbar(areas, ax=axes, label=label)
    bar.set_ticks(levels, labels=[f"{level:g}" for level in levels])


def _border(widths: xr.Dataset) -> Floats:
    """Closed line around the shapes of the model, columns (Ca, a/l)."""
    size = widths["size_ratio"].to_numpy()
    sides = [np.stack([widths[end].to_numpy(), size], axis=1) for end in ("lowest", "highest")]
    whole = np.concatenate([sides[0], sides[1][::-1]])
    return whole[np.isfinite(whole).all(axis=1)]


def _levels(width: Floats) -> list[float]:
    """Levels between the smallest and the largest width that is measured."""
    if np.isnan(width).all():
        return [float(level) for level in _LEVELS[-4:]]
    low, high = np.nanmin(width), np.nanmax(width)
    inner = [level for level in _LEVELS if low < level < high]
    if len(inner) > 1:
        return inner
    return [float(level) for level in np.geomspace(0.9 * low, 1.1 * high, 4)]


def _filled(values: Floats) -> Floats:
    """Values carried on along Ca beyond the border, where the picture is cut."""
    return pd.DataFrame(values).interpolate(axis=1, limit_direction="both").to_numpy()


def _errors(widths: xr.Dataset) -> str:
    """Model and errors in two lines."""
    stated, lab = (json.loads(widths.attrs[name]) for name in ("errors", "experiment"))
    scale, unit = (1.0, "l") if stated["unit_of_lengths"] == "l" else (1e6, "µm")
    extent, length = stated["axial_extent"], stated["axial_length"]
    of_length = "not measured" if length is None else f"± {scale * length:.3g} {unit}"
    share = {name: 100.0 * lab[name]["error"] / lab[name]["value"] for name in ("viscosity", "half_width")}
    return (
        f"{widths.attrs['model']}; errors: $L_z$ ± {scale * extent:.3g} {unit}, $L_a$ {of_length}, "
        f"$v_\\mathrm{{o}}$ ± {100.0 * stated['capsule_velocity_relative']:.2g} %,\n"
        f"$\\mu$ ± {share['viscosity']:.2g} %, $\\ell$ ± {share['half_width']:.2g} %"
    )
