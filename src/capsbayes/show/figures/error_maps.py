"""Heat maps of leave-one-out errors over (Ca, a/l), as in the paper's figure 11."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from capsbayes.show.figures.style import new_figure
from capsbayes.surrogate.plane import STRETCH_LIMIT, LeaveOneOut

SYMBOLS = ("Ca", "a/\\ell", "v_o/U")
SMALLEST = 1e-5  # below this every error looks the same
LONGEST_EDGE = 0.12  # of either range: longer triangles lie outside the cases


def heat_maps(*studies: LeaveOneOut) -> Figure:
    """Draw a row of three maps (Ca, a/l, v_o/U) for each study, with one colour scale a column."""
    figure = new_figure(13.0, 3.9 * len(studies))
    axes = figure.subplots(len(studies), 3, squeeze=False, sharex=True, sharey=True)
    for column in range(3):
        errors = np.concatenate([study.errors[:, column] for study in studies])
        norm = LogNorm(SMALLEST, max(np.nanmax(errors), 10 * SMALLEST))
        for row, study in enumerate(studies):
            heat_map(axes[row, column], study, column, norm)
    for row in axes:
        row[0].set_ylabel(r"$a/\ell$")
    for below in axes[-1]:
        below.set_xlabel(r"$Ca$")
    return figure


def heat_map(ax: Axes, study: LeaveOneOut, column: int, norm: LogNorm) -> Axes:
    """Draw the relative error of one parameter, and the dashed line on which Lambda = 1.04."""
    ca, size = study.truth[:, 0], study.truth[:, 1]
    known = np.isfinite(study.errors[:, column])
    triangles = _triangles(ca[known], size[known])
    colours = np.maximum(study.errors[known, column], SMALLEST)
    drawn = ax.tripcolor(triangles, colours, norm=norm, shading="gouraud", cmap="viridis", rasterized=True)
    ax.plot(ca, size, ".", color="white", markersize=1.5, alpha=0.7)
    stretch = study.stretch_ratio
    if stretch.min() < STRETCH_LIMIT < stretch.max():
        ax.tricontour(_triangles(ca, size), stretch, levels=[STRETCH_LIMIT], colors="black", linestyles="dashed")
    ax.set_title(rf"{study.method}: relative error of ${SYMBOLS[column]}$", fontsize=10)
    ax.figure.colorbar(drawn, ax=ax)
    return ax


def _triangles(ca: np.ndarray, size: np.ndarray) -> Triangulation:
    """Delaunay triangles of the scaled points, without the long ones that bridge the bays of the domain."""
    x, y = ca / np.ptp(ca), size / np.ptp(size)
    scaled = Triangulation(x, y)
    corners = np.stack([x, y], axis=1)[scaled.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    typical = np.quantile(edges, 0.9)
    return Triangulation(ca, size, scaled.triangles, mask=edges > max(LONGEST_EDGE, 2.5 * typical))
