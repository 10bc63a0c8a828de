"""A simulated shape in its channel: profile, silhouette and section, with its lengths."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from capsbayes.physics.simulation import SteadyState

__all__ = ["section_plot", "shape_plot", "write_shape_plot"]

_INK, _FILL, _RIM, _WALL = "#1f5a7a", "#dcebf3", "#c8552b", "#9a9a9a"


def shape_plot(state: SteadyState, ax: Axes) -> Axes:
    """Draw profile, silhouette, walls and the lengths L_z and L_a, all over l.

    Parameters
    ----------
    state : SteadyState
    ax : Axes

    Returns
    -------
    Axes
    """
    profile, silhouette = (np.vstack([o.points, o.points[:1]]) for o in (state.profile, state.silhouette))
    ax.fill(silhouette[:, 0], silhouette[:, 1], color=_FILL, linewidth=0)
    ax.plot(silhouette[:, 0], silhouette[:, 1], color=_RIM, linewidth=1, linestyle=(0, (4, 2)), label="silhouette")
    ax.plot(profile[:, 0], profile[:, 1], color=_INK, linewidth=1.8, label="profile, plane x = 0")
    ends = profile[:, 0].min() - 0.4, profile[:, 0].max() + 0.4
    for side in (-1.0, 1.0):
        ax.fill_between(ends, side, side * 1.12, color=_WALL, linewidth=0)
    nose, rear = profile[:, 0].max(), profile[:, 0].min()
    axial = state.profile.axial_length
    for y, start, name, value in ((1.28, rear, "L_z", nose - rear), (0.0, nose - axial, "L_a", axial)):
        ax.annotate("", (start, y), (nose, y), arrowprops={"arrowstyle": "<->", "color": "black", "linewidth": 0.8})
        ax.text((start + nose) / 2, y + 0.04, f"${name}/\\ell = {value:.3f}$", ha="center", va="bottom")
    ax.set(xlim=ends, ylim=(-1.2, 1.55), aspect="equal", xlabel=r"$z/\ell$", ylabel=r"$y/\ell$")
    ax.set_title(
        f"Ca = {state.capillary_number:g}, $a/\\ell$ = {state.size_ratio:g}, $v_o/U$ = {state.velocity_ratio:.3f}"
    )
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)
    return ax


def section_plot(state: SteadyState, ax: Axes) -> Axes:
    """Draw the capsule seen along the flow in the square section, all over l.

    Parameters
    ----------
    state : SteadyState
    ax : Axes

    Returns
    -------
    Axes
    """
    from scipy.spatial import ConvexHull

    points = state.surface_nodes[:, :2]
    hull = points[ConvexHull(points).vertices]
    ax.fill(hull[:, 0], hull[:, 1], facecolor=_FILL, edgecolor=_INK, linewidth=1.8)
    ax.plot([-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1], color=_WALL, linewidth=4)
    ax.set(xlim=(-1.15, 1.15), ylim=(-1.15, 1.15), aspect="equal", xlabel=r"$x/\ell$", ylabel=r"$y/\ell$")
    ax.set_title("seen along the flow")
    return ax


def write_shape_plot(state: SteadyState, path: str | os.PathLike[str]) -> Path:
    """Draw both views into one picture file; the ending chooses the format."""
    from matplotlib.figure import Figure

    path = Path(path)
    figure = Figure(figsize=(9.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.55, 1.0))
    shape_plot(state, left)
    section_plot(state, right)
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    figure.savefig(partial, dpi=160)
    os.replace(partial, path)
    return path
