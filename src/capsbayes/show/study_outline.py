"""Where on the outline the measured edges lie off the predicted ones, on average over the capsules."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capsbayes.diagnosis import AlongOutline, Finding
from capsbayes.diagnosis.regions import REGIONS, region_displacements
from capsbayes.profile import edge_lengths
from capsbayes.show.study_words import deviation_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["arc_share", "outline_finding"]

Floats = NDArray[np.float64]

_INK, _WALL = "#1f5a7a", "#9a9a9a"
_COLOURS = "RdBu_r"
_LABELS = {"nose": (0.76, -1.5), "flanks": (0.76, 1.5), "rear rim": (0.24, 1.5), "rear on the axis": (0.24, -1.5)}
"""Where the name of a region that is one place stands: share of the picture's width, and y over l."""
_SHARE_TICKS = (0, 25, 50, 75, 100)


def outline_finding(along: AlongOutline, finding: Finding) -> Figure:
    """Draw the mean outline coloured by the mean residual in um and in standard errors, and unrolled.

    Parameters
    ----------
    along : AlongOutline
    finding : Finding
        Its regions are named.

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 8.2), layout="constrained")
    axes = figure.subplot_mosaic([["um", "sigma"], ["unrolled", "unrolled"]], height_ratios=(2.3, 1.0))
    micrometres = 1e6 * along.displacement
    _coloured(axes["um"], along.outline, micrometres, "mean residual [µm]")
    _coloured(axes["sigma"], along.outline, along.displacement / along.error, "mean residual [standard errors]")
    _name_regions(axes["um"], along.outline, finding)
    axes["um"].set_title("outside (red) or inside (blue) the prediction, in µm")
    axes["sigma"].set_title("the same over its standard error")
    _unroll(axes["unrolled"], along)
    return figure


def arc_share(outline: Floats) -> Floats:
    """Share of the perimeter from the first vertex to each : (p,) array [%]."""
    lengths = edge_lengths(outline)
    return np.asarray(100.0 * np.concatenate([[0.0], np.cumsum(lengths[:-1])]) / lengths.sum())


def _coloured(ax: Axes, outline: Floats, values: Floats, label: str) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    ends = outline[:, 0].min() - 0.65, outline[:, 0].max() + 0.65
    for side in (-1.0, 1.0):
        ax.fill_between(ends, side, side * 1.1, color="#e2e2e2", linewidth=0)
        ax.plot(ends, [side, side], color=_WALL, linewidth=1.0)
    following = np.roll(outline, -1, axis=0)
    largest = float(np.max(np.abs(values))) or 1.0
    lines = LineCollection(
        list(np.stack([outline, following], axis=1)),
        cmap=_COLOURS,
        norm=Normalize(-largest, largest),
        linewidths=7.0,
        capstyle="round",
    )
    lines.set_array(0.5 * (values + np.roll(values, -1)))
    closed = np.vstack([outline, outline[:1]])
    ax.plot(*closed.T, color="#444444", linewidth=8.6, solid_joinstyle="round")
    ax.add_collection(lines)
    ax.set(xlim=ends, ylim=(-1.85, 1.85), aspect="equal", xlabel=r"$z/\ell$ (flow to the right)", ylabel=r"$y/\ell$")
    ax.set_yticks([-1.0, 0.0, 1.0])
    ax.figure.colorbar(lines, ax=ax, label=label, orientation="horizontal", shrink=0.75, aspect=30)


def _places(outline: Floats) -> dict[str, int]:
    """Middle vertex of each region that is one place, on the upper side."""
    upper = outline[:, 1] > -1e-3
    shapes = dict(zip(REGIONS, region_displacements(outline), strict=True))
    middles = {name: int(np.argmax(np.where(upper, shapes[name], 0.0))) for name in _LABELS}
    return middles | {"flanks": int(np.median(np.flatnonzero(upper & (shapes["flanks"] > 0.5))))}


def _name_regions(ax: Axes, outline: Floats, finding: Finding) -> None:
    found = {one.name: deviation_words(one) for one in finding.deviations}
    for name, place in _places(outline).items():
        if name in found:
            share, height = _LABELS[name]
            ax.annotate(
                f"{name}\n{found[name]}",
                outline[place],
                (ax.get_xlim()[0] + share * np.ptp(ax.get_xlim()), height),
                fontsize=8.5,
                ha="center",
                va="center",
                arrowprops={"arrowstyle": "-", "color": "#444444", "linewidth": 0.8},
                bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "#bbbbbb", "linewidth": 0.6},
            )


def _unroll(ax: Axes, along: AlongOutline) -> None:
    share = np.append(arc_share(along.outline), 100.0)
    mean, error = (1e6 * np.append(values, values[0]) for values in (along.displacement, along.error))
    ax.axhline(0.0, color=_WALL, linewidth=0.8)
    ax.fill_between(share, mean - error, mean + error, color=_INK, alpha=0.25, linewidth=0, label="± standard error")
    ax.plot(share, mean, color=_INK, label="mean over the capsules")
    for name, place in _places(along.outline).items():
        for at in {round(share[place], 3), round(100.0 - share[place], 3)}:
            ax.axvline(at, color="#bbbbbb", linewidth=0.8, linestyle=":")
            ax.text(at, 1.01, name, transform=ax.get_xaxis_transform(), ha="center", va="bottom", fontsize=9)
    ax.set(xlim=(0.0, 100.0), xlabel="place along the edge from the nose [% of the perimeter]", ylabel="residual [µm]")
    ax.set_xticks(_SHARE_TICKS)
    ax.legend(loc="upper center", frameon=False, fontsize=9, ncols=2)
    ax.margins(y=0.15)
