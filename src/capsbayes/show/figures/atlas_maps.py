"""Maps of a database over (Ca, a/l): the velocity and the lengths, cases as dots over the surrogate's surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from capsbayes.arrays import Floats
from capsbayes.show.figures.atlas_plane import BRANCH_STYLES, draw_borders, heading, kinds_of_case, prepare_plane
from capsbayes.show.figures.style import FILL, PALE, legend_below, new_figure, ratio_label
from capsbayes.surrogate import Surrogate
from capsbayes.surrogate.plane import Region

_LENGTHS = ("axial_extent", "axial_length", "parachute_depth")
_POINTS = (150, 100)  # of a surface, along sqrt(Ca) and a/l


def velocity_figure(surrogate: Surrogate) -> Figure:
    """Draw v_o/U over (Ca, a/l), as the paper's figure 6."""
    return _maps(surrogate, ("velocity_ratio",), 5.2)


def lengths_figure(surrogate: Surrogate) -> Figure:
    """Draw L_z/l, L_a/l and L_p/l over (Ca, a/l), one above the other."""
    return _maps(surrogate, _LENGTHS, 11.5)


def _maps(surrogate: Surrogate, names: tuple[str, ...], height: float) -> Figure:
    figure = new_figure(7.4, height)
    axes = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
    for ax, name in zip(axes, names, strict=True):
        map_plot(surrogate, name, ax).label_outer()
    figure.suptitle(heading(surrogate.database), fontsize=11)
    legend_below(figure, axes[0], 4, fontsize=10)
    return figure


def map_plot(surrogate: Surrogate, name: str, ax: Axes) -> Axes:
    """Draw one quantity over (Ca, a/l): contours where the surrogate has an answer, cases as dots of the same colours.

    The quantity is one that a prediction and a database have, as ``"velocity_ratio"``.
    """
    prepare_plane(ax, surrogate.database)
    cases = surrogate.database.converged
    levels = MaxNLocator(16, steps=[1, 2, 5, 10]).tick_values(float(cases[name].min()), float(cases[name].max()))
    shared: dict[str, Any] = {"vmin": levels[0], "vmax": levels[-1], "cmap": "viridis"}
    for region in surrogate.domain.regions:
        ca, size, values = _surface(surrogate, region, name)
        filled = ax.contourf(ca, size, np.clip(values, levels[0], levels[-1]), levels=levels, **shared)
        lines = ax.contour(ca, size, values, levels=levels[1:-1], colors="white", linewidths=0.6)
        for text in ax.clabel(lines, fontsize=8):
            text.set_path_effects([withStroke(linewidth=1.5, foreground="#333333")])
    dots: dict[str, Any] = {"s": 11, "edgecolors": "black", "linewidths": 0.4, "zorder": 2.5, "label": "case", **shared}
    ax.scatter(cases["capillary_number"], cases["size_ratio"], c=cases[name], **dots)
    draw_borders(ax, surrogate.database)
    ax.figure.colorbar(filled, ax=ax, label=ratio_label(name))
    return ax


def _surface(surrogate: Surrogate, region: Region, name: str) -> tuple[Floats, Floats, Floats]:
    """Ca, a/l and the quantity over one region, on lines of equal a/l from border to border : three (k, m) arrays."""
    along = np.linspace(1e-6, 1.0 - 1e-6, _POINTS[0])  # the borders themselves may belong to another region too
    columns = region.size_ratio
    size = np.union1d(columns, np.linspace(columns[0], columns[-1], _POINTS[1]))
    lowest, highest = np.sqrt([region.borders(value) for value in size]).T[:, :, None]
    ca = (lowest + along * (highest - lowest)) ** 2
    sizes = np.broadcast_to(size[:, None], ca.shape)
    prediction = surrogate({"capillary_number": ca.ravel(), "size_ratio": sizes.ravel()})
    return ca, sizes, np.reshape(getattr(prediction, name), ca.shape)


def velocity_surface_figure(surrogate: Surrogate) -> Figure:
    """Draw the cases in the space (Ca, a/l, v_o/U) over the surrogate's surface, as the paper's figure 7."""
    database = surrogate.database
    figure = new_figure(7.4, 6.4, layout=None)
    ax: Any = figure.add_axes((0.0, 0.02, 0.94, 0.92), projection="3d", computed_zorder=False)
    for region in surrogate.domain.regions:
        surface = _surface(surrogate, region, "velocity_ratio")
        style = {"color": FILL, "edgecolor": PALE, "linewidth": 0.3, "shade": False}
        ax.plot_surface(*surface, rcount=24, ccount=24, **style)
    kinds = kinds_of_case(database)
    names = ("capillary_number", "size_ratio", "velocity_ratio")
    for name, style in BRANCH_STYLES.items():
        points = [database[column][kinds[name]] for column in names]
        ax.plot(*points, linestyle="none", markersize=3.5, label=name, **style)
    ax.set(**dict(zip(("xlabel", "ylabel", "zlabel"), map(ratio_label, names), strict=True)))
    ax.view_init(elev=30.0, azim=130.0)
    ax.legend(loc="upper right", frameon=False)
    figure.suptitle(heading(database), fontsize=11)
    return figure
