"""The plane (Ca, a/l) of a database: its cases, and the borders of steady shapes.

Maps of a database over (Ca, a/l): the velocity and the lengths, cases as dots over the surrogate's surface.

A table of the shapes of a database: profiles between the walls, Ca to the right and a/l upward.

The atlas of a database: what it covers, its shapes and maps, and what an effect changes, as figures.

Heat maps of leave-one-out errors over (Ca, a/l), as in the paper's figure 11.
"""

from __future__ import annotations

import contextlib
import textwrap
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE, LOST_FROM_REST, NO_EFFECT, SNAP_THROUGH, Database
from capsbayes.errors import DatabaseError
from capsbayes.parameters import PARAMETERS
from capsbayes.report.style import (
    ACCENT,
    FILL,
    INK,
    PALE,
    WALL,
    draw_walls,
    label_plane,
    legend_below,
    new_figure,
    ratio_label,
)
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate
from capsbayes.surrogate.plane import CONVEX, STRETCH_LIMIT, LeaveOneOut, Region

_NONE = "#555555"
_TICKS = (0.003, 0.01, 0.02, 0.04, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)

BRANCH_STYLES: dict[str, dict[str, Any]] = {
    "parachute": {"marker": "o", "color": INK},
    "convex": {"marker": "^", "color": ACCENT},
}
_OTHER_STYLES: dict[str, dict[str, Any]] = {
    "no steady state": {"marker": "o", "color": _NONE, "markerfacecolor": "none"},
    "not resolved or not computed": {"marker": "D", "color": WALL, "markerfacecolor": "none", "markersize": 3.2},
}
_BORDER_STYLES: dict[str, dict[str, Any]] = {
    LIMIT_OF_DATABASE: {"color": "black", "linewidth": 1.2, "linestyle": (0, (4, 2))},
    LIMIT_OF_EXISTENCE: {"color": "black", "linewidth": 2.0},
    SNAP_THROUGH: {"color": ACCENT, "linewidth": 1.8},
    LOST_FROM_REST: {"color": ACCENT, "linestyle": "none", "marker": "x", "markersize": 5.5},
}


def kinds_of_case(database: Database) -> dict[str, Booleans]:
    """Sort the cases into "parachute", "convex", "no steady state", "not resolved or not computed" : (c,) masks."""
    status = database["status"]
    done, absent = status == Status.DONE.name, status == Status.NO_STEADY_STATE.name
    convex = done & (database["parachute_depth"] < CONVEX)
    masks = (done & ~convex, convex, absent, ~(done | absent))
    return dict(zip((*BRANCH_STYLES, *_OTHER_STYLES), masks, strict=True))


def border_curve(database: Database, *kinds: str) -> tuple[Floats, Floats]:
    """Return Ca and a/l of the borders of some kinds at one value of the effect : (k,) arrays [-].

    The a/l are all that have any border, rising; Ca is NaN where it is of another kind.
    """
    size, ca = np.round(database["border_size_ratio"], 6), database["border_capillary_number"]
    columns = np.unique(size)
    curve = np.full(len(columns), np.nan)
    chosen = np.isin(database["border_kind"], kinds)
    curve[np.searchsorted(columns, size[chosen])] = ca[chosen]
    return curve, columns


def prepare_plane(ax: Axes, database: Database) -> Axes:
    """Give axes the range of the database, on a square-root scale of Ca: the branches lie close together at low Ca."""
    ca, size = database["capillary_number"], database["size_ratio"]
    ax.set_xscale("function", functions=(lambda x: np.sqrt(np.maximum(x, 0.0)), np.square))
    low, high = float(ca.min()), float(ca.max())
    step = 0.02 * (high**0.5 - low**0.5) + 1e-3
    first, last = max(low**0.5 - step, 0.0) ** 2, (high**0.5 + step) ** 2
    margin = 0.04 * float(np.ptp(size)) + 1e-3
    ax.set(xlim=(first, last), ylim=(float(size.min()) - margin, float(size.max()) + margin))
    label_plane(ax, _TICKS, ", square-root scale")
    return ax


def draw_borders(ax: Axes, database: Database) -> None:
    """Draw each kind of border that the database has; the label of a line is its kind.

    The limit of the database goes on under the limit of existence, so that the border has no gap between the two.
    """
    for kind, style in _BORDER_STYLES.items():
        if kind in database["border_kind"]:
            upper = (LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE)
            curve = border_curve(database, *(upper if kind == LIMIT_OF_DATABASE else (kind,)))
            ax.plot(*curve, label=kind, **{"marker": ".", "markersize": 2.5, **style})


def cases_figure(database: Database) -> Figure:
    """Draw every case and the borders, as the paper's figure 5; one plane for each value of an effect."""
    values = database.values
    columns = 1 if len(values) == 1 else 2
    rows = -(-len(values) // columns)
    figure = new_figure(7.4, 5.6 if columns == 1 else 0.9 + 3.0 * rows)
    for place, value in enumerate(values, start=1):
        ax = figure.add_subplot(rows, columns, place)
        _draw_cases(ax, database.at_value(value))
        if database.effect != NO_EFFECT:
            ax.set_title(of_effect(database, value), fontsize=10)
    entries = {
        label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    order = [label for label in (*BRANCH_STYLES, *_OTHER_STYLES, *_BORDER_STYLES) if label in entries]
    style: dict[str, Any] = {"loc": "outside lower center", "ncols": 3, "frameon": False, "fontsize": 10}
    figure.legend([entries[label] for label in order], order, **style)
    figure.suptitle(heading(database), fontsize=11)
    return figure


def _draw_cases(ax: Axes, database: Database) -> None:
    prepare_plane(ax, database)
    styles = BRANCH_STYLES | _OTHER_STYLES
    usual: dict[str, Any] = {"linestyle": "none", "markersize": 4.0, "markeredgewidth": 0.9}
    for name, rows in kinds_of_case(database).items():
        if rows.any():
            places = database["capillary_number"][rows], database["size_ratio"][rows]
            ax.plot(*places, label=name, **(usual | styles[name]))
    draw_borders(ax, database)


def heading(database: Database) -> str:
    """Return law, cross-section, mesh, and the number of cases with a steady state, in two lines."""
    attributes = database.dataset.attrs
    meshes = ", ".join(map(str, np.unique(database["refinement"])))
    return (
        f"{attributes['law']} membrane, {attributes['cross_section']} cross-section, mesh n = {meshes}\n"
        f"{len(database.converged)} of {len(database)} cases with a steady state"
    )


def of_effect(database: Database, value: float) -> str:
    """Return a value of the effect in words."""
    null = " (null)" if value == database.null_value else ""
    return f"{database.effect.replace('_', ' ')} = {value:g}{null}"


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


_FAINT = "#555555"
_CA, _SIZES = 6, 5  # columns and rows of the table
_OUTSIDE = 1.14  # outer face of the walls, over l


def table_of_cases(database: Database) -> tuple[Floats, Floats]:
    """Choose Ca (k,) and a/l (m,) of the table, those of steady states nearest to even steps of sqrt(Ca) and of a/l.

    A Ca that is rare compared with others near the same step is not chosen.
    """
    cases = database.converged
    ca, counts = np.unique(cases["capillary_number"], return_counts=True)
    sizes = np.unique(np.round(cases["size_ratio"], 6))
    return ca[_spread(np.sqrt(ca), counts, _CA)], sizes[_spread(sizes, np.ones(len(sizes)), _SIZES)]


def _spread(values: Floats, counts: NDArray[Any], steps: int) -> Integers:
    """Indices of the rising values nearest to even steps, out of those at least half as common as any other there."""
    even = np.linspace(values[0], values[-1], steps)
    distance = np.abs(values[:, None] - even)
    owner = np.argmin(distance, axis=1)
    rare = [2 * count < counts[owner == step].max() for count, step in zip(counts, owner, strict=True)]
    distance[rare] = np.inf
    return np.array([np.argmin(np.where(owner == step, distance[:, step], np.inf)) for step in np.unique(owner)])


def cases_of_cell(database: Database, capillary_numbers: Floats, column: int, size_ratio: float) -> Booleans:
    """Select the cases of one Ca that a cell of the table shows : (c,) array, at most one for each value of an effect.

    They are those of its a/l at the Ca nearest, in sqrt(Ca), to that of its column among the capillary numbers (k,).
    """
    ca = database["capillary_number"]
    distance = np.abs(np.sqrt(ca)[:, None] - np.sqrt(capillary_numbers))
    here = (np.round(database["size_ratio"], 6) == size_ratio) & (np.argmin(distance, axis=1) == column)
    nearest = np.min(distance[here, column], initial=np.inf)
    return here & (distance[:, column] == nearest)


def shapes_figure(database: Database) -> Figure:
    """Draw profiles in the plane x = 0 between the walls, lengths over l; those of all values of an effect together."""
    ca, sizes = table_of_cases(database)
    values = database.values
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, len(values)))
    inks: list[Any] = [INK] if len(values) == 1 else list(shades)
    profiles = database["profile"][..., 0]
    ends = float(np.nanmin(profiles)) - 0.1, float(np.nanmax(profiles)) + 0.1
    figure = new_figure(9.6, 1.0 + 9.0 * len(sizes) / len(ca) * 2.3 / (ends[1] - ends[0]))
    axes = figure.subplots(len(sizes), len(ca), squeeze=False, sharex=True, sharey=True)
    for ax_row, size in zip(axes, sizes[::-1], strict=True):
        for k, ax in enumerate(ax_row):
            _draw_channel(ax, ends)
            here = cases_of_cell(database, ca, k, size)
            _draw_profiles(ax, database, here, inks)
            _draw_words(ax, database, here, ca[k])
    for ax, value in zip(axes[0], ca, strict=True):
        ax.set_title(rf"$\mathrm{{Ca}}$ = {value:g}", fontsize=11)
    for ax, size in zip(axes[:, 0], sizes[::-1], strict=True):
        ax.set_ylabel(rf"$a/\ell$ = {size:g}", fontsize=11)
    if database.effect != NO_EFFECT:
        for value, ink in zip(values, inks, strict=True):
            axes[0, 0].plot([], [], color=ink, label=of_effect(database, value))
        figure.legend(loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{heading(database)}; flow to the right", fontsize=11)
    return figure


def _draw_channel(ax: Axes, ends: tuple[float, float]) -> None:
    draw_walls(ax, ends, _OUTSIDE)
    ax.set(xlim=ends, ylim=(-_OUTSIDE, _OUTSIDE), aspect="equal", xticks=[], yticks=[])
    for spine in ax.spines.values():
        spine.set_visible(False)


def _draw_profiles(ax: Axes, database: Database, here: Booleans, inks: list[Any]) -> None:
    for row in np.flatnonzero(here & (database["status"] == Status.DONE.name)):
        ink = inks[np.searchsorted(database.values, database["effect_value"][row])]
        fill = FILL if len(inks) == 1 else "none"
        ax.fill(*database["profile"][row].T, facecolor=fill, edgecolor=ink, linewidth=1.3)


def _draw_words(ax: Axes, database: Database, here: Booleans, heading_ca: float) -> None:
    """Write why a cell is empty, and its Ca where it differs from that above the table."""
    kinds = [name for name, rows in kinds_of_case(database).items() if (rows & here).any()]
    ca = database["capillary_number"][here]
    words = [f"Ca = {ca[0]:.4g}"] if ca.size and ca[0] != heading_ca else []
    if not set(BRANCH_STYLES) & set(kinds):
        words.append(textwrap.fill(kinds[0] if kinds else "not in the database", 16))
    ax.text(0.5, 0.5, "\n".join(words), transform=ax.transAxes, ha="center", va="center", color=_FAINT, fontsize=9)


_QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")


def atlas(database: Database) -> dict[str, Figure]:
    """Draw the figures of a database.

    Returns
    -------
    dict of str to Figure
        Always ``"cases"`` and ``"shapes"``; of an effect ``"changes"``; else ``"velocity"``, ``"velocity-surface"``
        and ``"lengths"``, unless the cases are too few for a surrogate.

    Raises
    ------
    DatabaseError
        If no case has a steady state.
    """
    if not len(database.converged):
        raise DatabaseError(f"expected a database with steady states to draw, got none in {len(database)} cases")
    figures = {"cases": cases_figure(database), "shapes": shapes_figure(database)}
    if database.effect != NO_EFFECT:
        return figures | {"changes": changes_figure(database)}
    with contextlib.suppress(DatabaseError):
        surrogate = Surrogate(database)
        figures["velocity"] = velocity_figure(surrogate)
        figures["velocity-surface"] = velocity_surface_figure(surrogate)
        figures["lengths"] = lengths_figure(surrogate)
    return figures


def changes(database: Database, value: float, name: str) -> tuple[Floats, Floats, Floats]:
    """Return Ca, a/l and the relative change of a quantity from the null value to another : (c,) arrays [-].

    The database is that of an effect; the cases are those that both values have.
    """
    case = ["capillary_number", "size_ratio"]
    there, null = (
        pd.DataFrame({column: cases[column] for column in (*case, name)})
        for cases in (database.at_value(each).converged for each in (value, database.null_value))
    )
    both = there.merge(null, on=case, suffixes=("", "_null"))
    change = both[name] / both[f"{name}_null"] - 1.0
    return both["capillary_number"].to_numpy(), both["size_ratio"].to_numpy(), change.to_numpy()


def changes_figure(database: Database) -> Figure:
    """Draw the changes of L_z, L_a and v_o/U by an effect, a row for each value, a scale for each quantity."""
    values = [value for value in database.values if value != database.null_value]
    figure = new_figure(9.6, 1.9 + 2.3 * len(values))
    axes = figure.subplots(len(values), len(_QUANTITIES), squeeze=False, sharex=True, sharey=True)
    for column, name in zip(axes.T, _QUANTITIES, strict=True):
        changed = [changes(database, value, name) for value in values]
        largest = 100.0 * max(float(np.abs(change).max(initial=1e-6)) for *_, change in changed)
        colours: dict[str, Any] = {"vmin": -largest, "vmax": largest, "cmap": "PuOr"}
        style = {"s": 26, "edgecolors": "#555555", "linewidths": 0.4}
        for ax, (ca, size, change) in zip(column, changed, strict=True):
            prepare_plane(ax, database).label_outer()
            drawn = ax.scatter(ca, size, c=100.0 * change, **colours, **style)
        label = f"change of ${PARAMETERS[name].latex}$ [%]"
        figure.colorbar(drawn, ax=list(column), location="bottom", label=label, aspect=30)
    for ax, value in zip(axes[:, 1], values, strict=True):
        ax.set_title(of_effect(database, value), fontsize=11)
    null = of_effect(database, database.null_value)
    figure.suptitle(f"{heading(database)}; change from {null}", fontsize=11)
    return figure


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
