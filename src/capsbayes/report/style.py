"""The style that all figures share: colours, frames, walls, legends, and how they are written to a file."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from capsbayes.arrays import Floats
from capsbayes.files.output_file import write_file
from capsbayes.parameters import PARAMETERS

INK, PALE, FILL = "#1f5a7a", "#8fc1dc", "#dcebf3"
ACCENT, WALL = "#c8552b", "#9a9a9a"


def new_figure(width: float, height: float, **layout: Any) -> Figure:
    """Return an empty figure of a size in inches; it belongs to no window."""
    return Figure(figsize=(width, height), **({"layout": "constrained"} | layout))


def new_plot(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a figure of one pair of axes, and these."""
    figure = new_figure(width, height)
    return figure, figure.subplots()


def framed(ax: Axes, hidden: tuple[str, ...] = ("top", "right")) -> Axes:
    """Hide some sides of the frame of axes."""
    ax.spines[list(hidden)].set_visible(False)
    return ax


def legend_below(figure: Figure, entries: Axes | Sequence[Artist], columns: int, **style: Any) -> None:
    """Put the legend of axes, or of artists that have labels, below the figure."""
    handles = entries.get_legend_handles_labels()[0] if isinstance(entries, Axes) else entries
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, **style)


def second_scale(ax: Axes, factor: float) -> Any:
    """Put a second scale above axes, a multiple of that below."""
    return ax.secondary_xaxis("top", functions=(partial(np.multiply, factor), partial(np.multiply, 1.0 / factor)))


def plain_numbers(*scales: Axis) -> None:
    """Put plain numbers at the ticks of logarithmic scales, also where they span less than a decade."""
    for scale in scales:
        low, high = scale.get_view_interval()
        subs = (1.0, 2.0, 5.0) if high > 8.0 * low else tuple(np.arange(1.0, 10.0, 1.0 if high > 2.0 * low else 0.5))
        scale.set_major_locator(LogLocator(subs=subs, numticks=12))
        scale.set_major_formatter(StrMethodFormatter("{x:g}"))
        scale.set_minor_formatter(NullFormatter())


def outlined(labels: Iterable[Text]) -> None:
    """Put a dark line around white labels of contours."""
    for label in labels:
        label.set_path_effects([withStroke(linewidth=1.5, foreground="#333333")])


def ratio_label(name: str) -> str:
    """Return the axis label of a ratio."""
    return f"${PARAMETERS[name].latex}$ [-]"


def label_plane(ax: Axes, ticks: tuple[float, ...], scale: str = "") -> None:
    """Label axes of (Ca, a/l), with those of the ticks of Ca that are in sight, and the scale of Ca in words."""
    first, last = ax.get_xlim()
    shown = [tick for tick in ticks if first <= tick <= last]
    ax.set_xticks(shown, [f"{tick:g}" for tick in shown])
    ax.minorticks_off()
    ax.set(xlabel=f"{ratio_label('capillary_number')}{scale}", ylabel=ratio_label("size_ratio"))


def without_l(name: str) -> str:
    """Return the symbol of a quantity in LaTeX; of a measured length without the l that it is stated over."""
    latex = PARAMETERS[name].latex
    return latex.removesuffix(r"/\ell") if name.startswith("axial") else latex


def closed(points: Floats) -> Floats:
    """Return points of an outline with the first again at the end : (p + 1, 2) array."""
    return np.vstack([points, points[:1]])


def draw_walls(ax: Axes, ends: tuple[float, float], outer: float, **style: Any) -> None:
    """Draw both walls of the channel, from y = 1 to an outer height, over l."""
    whole: dict[str, Any] = {"color": WALL, "linewidth": 0} | style
    for side in (-1.0, 1.0):
        ax.fill_between(ends, side, side * outer, **whole)


def write_figure(figure: Figure, path: str | os.PathLike[str], dpi: int = 160) -> Path:
    """Write a figure; the ending chooses the format."""
    content = io.BytesIO()
    figure.savefig(content, format=Path(path).suffix[1:], dpi=dpi)
    return write_file(path, content.getvalue())
