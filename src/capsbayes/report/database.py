"""A database: its page and tables, the atlas of what it covers and what an effect changes, and errors over it."""

from __future__ import annotations

import contextlib
import json
import textwrap
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE, LOST_FROM_REST, NO_EFFECT, SNAP_THROUGH, Database
from capsbayes.errors import DatabaseError
from capsbayes.parameters import PARAMETERS
from capsbayes.prediction import ERRING
from capsbayes.report import style
from capsbayes.report.page import page
from capsbayes.report.population import status_table
from capsbayes.report.style import ACCENT, FILL, INK, PALE, WALL
from capsbayes.report.tables import Code, Symbols, flat, table
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate
from capsbayes.surrogate.plane import CONVEX, STRETCH_LIMIT, LeaveOneOut, Region

_FAINT = "#555555"
_TICKS = (0.003, 0.01, 0.02, 0.04, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)
_BRANCH_STYLES: dict[str, dict[str, Any]] = {
    "parachute": {"marker": "o", "color": INK},
    "convex": {"marker": "^", "color": ACCENT},
}
_CASE_STYLES: dict[str, dict[str, Any]] = _BRANCH_STYLES | {
    "no steady state": {"marker": "o", "color": _FAINT, "markerfacecolor": "none"},
    "not resolved or not computed": {"marker": "D", "color": WALL, "markerfacecolor": "none", "markersize": 3.2},
}
_BORDER_STYLES: dict[str, dict[str, Any]] = {
    LIMIT_OF_DATABASE: {"color": "black", "linewidth": 1.2, "linestyle": (0, (4, 2))},
    LIMIT_OF_EXISTENCE: {"color": "black", "linewidth": 2.0},
    SNAP_THROUGH: {"color": ACCENT, "linewidth": 1.8},
    LOST_FROM_REST: {"color": ACCENT, "linestyle": "none", "marker": "x", "markersize": 5.5},
}
_COLUMNS, _ROWS = 6, 5  # of the table of shapes: Ca and a/l
_OUTSIDE = 1.14  # outer face of the walls, over l
_POINTS = (150, 100)  # of a surface, along sqrt(Ca) and a/l
_SMALLEST = 1e-5  # below this every error looks the same
_LONGEST_EDGE = 0.12  # of either range: longer triangles lie outside the cases


def database_page(database: Database, *, source: str = "") -> str:
    """Return a database, of which `source` is the name or the file, as a whole page in HTML, its pictures within it."""
    statuses = {Status[name]: count for name, count in Counter(map(str, database["status"])).most_common()}
    tables = {
        "contents": contents_table(database),
        "domain": domain_table(database),
        "statuses": status_table(statuses, "cases"),
        "origin": origin_table(database, source),
        "settings": table(("", ""), flat(database.settings)),
    }
    words = {"name": Path(source).stem if source else "without a name", "domain_sentence": domain_sentence(database)}
    return page("database.html", database=database, tables=tables, figures=atlas(database), **words)


def contents_table(database: Database) -> pd.DataFrame:
    """Return law, cross-section, effect, ranges and mesh."""
    attributes, done = database.dataset.attrs, database.converged
    effect = "none"
    if database.effect != NO_EFFECT:
        known, values = PARAMETERS.get(database.effect), ", ".join(f"{value:g}" for value in database.values)
        effect = database.effect.replace("_", " ") + (f", {known.meaning}" if known else "")
        effect += f": {values}; absent at {database.null_value:g}"
    errors = json.loads(attributes.get("mesh_error", "{}"))
    names = [name for name in ERRING if name in errors]
    mesh_error = ", ".join(f"{PARAMETERS[name].symbol} {100.0 * errors[name]:.2g} %" for name in names)
    rows = [
        ("law of the membrane", str(attributes["law"])),
        ("cross-section of the channel", str(attributes["cross_section"])),
        ("effect", effect),
        ("bending modulus", Symbols(f"{float(attributes['bending']):g} G_s a^2")),
        ("pre-inflation", f"{float(attributes['pre_inflation']):g}"),
        ("cases", f"{len(database)}, of which {len(done)} with a steady shape"),
        (Symbols("capillary number Ca"), _range(done["capillary_number"])),
        (Symbols("size ratio a/l"), f"{_range(done['size_ratio'])}, {len(np.unique(done['size_ratio']))} columns"),
        ("mesh", f"refinement {', '.join(map(str, np.unique(database['refinement'])))}"),
        ("error of the mesh", Symbols(mesh_error or "not stated")),
    ]
    return table(("", ""), rows)


def domain_sentence(database: Database) -> str:
    """Say where steady shapes exist."""
    done = database.converged
    limits = database["border_capillary_number"][database["border_kind"] == LIMIT_OF_EXISTENCE]
    words = f"It answers for Ca {_range(done['capillary_number'])} and a/l {_range(done['size_ratio'])}"
    if len(limits):
        words += f"; beyond Ca {_range(limits)}, depending on the size, there is no steady shape"
    return f"{words}. Outside, nothing is extrapolated."


def domain_table(database: Database) -> pd.DataFrame:
    """Return where the cases of each a/l end, for each value of the effect."""
    effect = database.effect != NO_EFFECT
    head = [database.effect.replace("_", " ")] * effect
    head += ["a/l", "Ca from", "to", "ends at the", "snap-through at Ca"]
    rows = [[f"{value:g}"] * effect + row for value in database.values for row in _columns(database.at_value(value))]
    return table([Symbols(text) for text in head], rows, numbers=range(3 + effect))


def _columns(part: Database) -> Iterator[list[str]]:
    """Yield a row of `domain_table` for each a/l."""
    done = part.converged
    border, kinds = np.round(part["border_size_ratio"], 6), part["border_kind"]
    for size in np.unique(np.round(part["size_ratio"], 6)):
        ca = done["capillary_number"][np.round(done["size_ratio"], 6) == size]
        ends = np.flatnonzero((border == size) & np.isin(kinds, (LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE)))
        snaps = part["border_capillary_number"][(border == size) & (kinds == SNAP_THROUGH)]
        last = f"{part['border_capillary_number'][ends[0]]:.4g}" if len(ends) else ""
        why = str(kinds[ends[0]]).replace(" ", "\N{NO-BREAK SPACE}") if len(ends) else "no border is known"
        first = f"{ca.min():.3g}" if len(ca) else "none"
        yield [f"{size:g}", first, last, why, f"{snaps[0]:.3g}" if len(snaps) else ""]


def origin_table(database: Database, source: str) -> pd.DataFrame:
    """Return source, version, date and hash."""
    attributes = database.dataset.attrs
    how = "open" if source in Database.shipped() else "read"
    rows = [
        *([("file", source)] if source else []),
        ("source", str(attributes["source"])),
        ("made by", f"capsbayes, version {attributes['version']}"),
        ("made on", str(attributes["created"])),
        ("sha256 of the content", Code(database.sha256)),
        ("read it with", Code(f'capsbayes.Database.{how}("{source}")')),
    ]
    return table(("", ""), rows)


def _range(values: Any) -> str:
    return f"{float(np.min(values)):.3g} to {float(np.max(values)):.3g}" if len(values) else "none"


# The atlas


def atlas(database: Database) -> dict[str, Figure]:
    """Draw "cases" and "shapes", of an effect "changes", else the maps, unless cases are too few for a surrogate."""
    if not len(database.converged):
        raise DatabaseError(f"expected a database with steady states to draw, got none in {len(database)} cases")
    figures = {"cases": cases_figure(database), "shapes": shapes_figure(database)}
    if database.effect != NO_EFFECT:
        return figures | {"changes": changes_figure(database)}
    with contextlib.suppress(DatabaseError):
        surrogate = Surrogate(database)
        figures["velocity"] = maps_figure(surrogate, "velocity_ratio")
        figures["velocity-surface"] = velocity_surface_figure(surrogate)
        figures["lengths"] = maps_figure(surrogate, "axial_extent", "axial_length", "parachute_depth")
    return figures


def _titled(figure: Figure, database: Database, further: str = "") -> Figure:
    """The figure under law, cross-section, mesh, and the number of cases with a steady state, in two lines."""
    attributes = database.dataset.attrs
    meshes = ", ".join(map(str, np.unique(database["refinement"])))
    figure.suptitle(
        f"{attributes['law']} membrane, {attributes['cross_section']} cross-section, mesh n = {meshes}\n"
        f"{len(database.converged)} of {len(database)} cases with a steady state{further}",
        fontsize=11,
    )
    return figure


def _of_effect(database: Database, value: float) -> str:
    """A value of the effect in words."""
    null = " (null)" if value == database.null_value else ""
    return f"{database.effect.replace('_', ' ')} = {value:g}{null}"


# The plane (Ca, a/l): the cases, and the borders of steady shapes


def _kinds_of_case(database: Database) -> dict[str, Booleans]:
    """Sort the cases by the names of `_CASE_STYLES` : (c,) masks."""
    status = database["status"]
    done, absent = status == Status.DONE.name, status == Status.NO_STEADY_STATE.name
    convex = done & (database["parachute_depth"] < CONVEX)
    return dict(zip(_CASE_STYLES, (done & ~convex, convex, absent, ~(done | absent)), strict=True))


def _prepare_plane(ax: Axes, database: Database) -> None:
    """Give axes the range of the database, on a square-root scale of Ca: the branches lie close together at low Ca."""
    ca, size = database["capillary_number"], database["size_ratio"]
    ax.set_xscale("function", functions=(lambda x: np.sqrt(np.maximum(x, 0.0)), np.square))
    low, high = float(ca.min()) ** 0.5, float(ca.max()) ** 0.5
    step, margin = 0.02 * (high - low) + 1e-3, 0.04 * float(np.ptp(size)) + 1e-3
    sizes = float(size.min()) - margin, float(size.max()) + margin
    ax.set(xlim=(max(low - step, 0.0) ** 2, (high + step) ** 2), ylim=sizes)
    style.label_plane(ax, _TICKS, ", square-root scale")


def _draw_borders(ax: Axes, database: Database) -> None:
    """Draw each kind of border, broken where an a/l has another kind; that of the database goes on under existence."""
    size, ca, kinds = (database[f"border_{name}"] for name in ("size_ratio", "capillary_number", "kind"))
    columns, place = np.unique(np.round(size, 6), return_inverse=True)
    for kind, look in _BORDER_STYLES.items():
        if kind in kinds:
            chosen = (kinds == kind) | ((kind == LIMIT_OF_DATABASE) & (kinds == LIMIT_OF_EXISTENCE))
            curve = np.full(len(columns), np.nan)
            curve[place[chosen]] = ca[chosen]
            line: dict[str, Any] = {"marker": ".", "markersize": 2.5} | look
            ax.plot(curve, columns, label=kind, **line)


def cases_figure(database: Database) -> Figure:
    """Draw every case and the borders, as the paper's figure 5; one plane for each value of an effect."""
    values = database.values
    columns = 1 if len(values) == 1 else 2
    rows = -(-len(values) // columns)
    figure = style.new_figure(7.4, 5.6 if columns == 1 else 0.9 + 3.0 * rows)
    usual: dict[str, Any] = {"linestyle": "none", "markersize": 4.0, "markeredgewidth": 0.9}
    entries: dict[str, Any] = {}
    for place, value in enumerate(values, start=1):
        ax, part = figure.add_subplot(rows, columns, place), database.at_value(value)
        _prepare_plane(ax, part)
        for name, chosen in _kinds_of_case(part).items():
            if chosen.any():
                points = part["capillary_number"][chosen], part["size_ratio"][chosen]
                ax.plot(*points, label=name, **(usual | _CASE_STYLES[name]))
        _draw_borders(ax, part)
        if database.effect != NO_EFFECT:
            ax.set_title(_of_effect(database, value), fontsize=10)
        entries |= {str(line.get_label()): line for line in ax.lines}
    order = [label for label in (*_CASE_STYLES, *_BORDER_STYLES) if label in entries]
    style.legend_below(figure, [entries[label] for label in order], 3, fontsize=10)
    return _titled(figure, database)


# Maps: cases as dots over the surface of the surrogate


def maps_figure(surrogate: Surrogate, *names: str) -> Figure:
    """Draw quantities over (Ca, a/l), one above the other, v_o/U as the paper's figure 6."""
    figure = style.new_figure(7.4, 2.05 + 3.15 * len(names))
    axes = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
    for ax, name in zip(axes, names, strict=True):
        _draw_map(ax, surrogate, name)
        ax.label_outer()
    style.legend_below(figure, axes[0], 4, fontsize=10)
    return _titled(figure, surrogate.database)


def _draw_map(ax: Axes, surrogate: Surrogate, name: str) -> None:
    """Draw contours where the surrogate has an answer, and cases as dots of the same colours."""
    _prepare_plane(ax, surrogate.database)
    cases = surrogate.database.converged
    levels = MaxNLocator(16, steps=[1, 2, 5, 10]).tick_values(float(cases[name].min()), float(cases[name].max()))
    shared: dict[str, Any] = {"vmin": levels[0], "vmax": levels[-1], "cmap": "viridis"}
    for region in surrogate.domain.regions:
        ca, size, values = _surface(surrogate, region, name)
        filled = ax.contourf(ca, size, np.clip(values, levels[0], levels[-1]), levels=levels, **shared)
        lines = ax.contour(ca, size, values, levels=levels[1:-1], colors="white", linewidths=0.6)
        style.outlined(ax.clabel(lines, fontsize=8))
    dots: dict[str, Any] = {"s": 11, "edgecolors": "black", "linewidths": 0.4, "zorder": 2.5, "label": "case"}
    ax.scatter(cases["capillary_number"], cases["size_ratio"], c=cases[name], **dots, **shared)
    _draw_borders(ax, surrogate.database)
    ax.figure.colorbar(filled, ax=ax, label=style.ratio_label(name))


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
    figure = style.new_figure(7.4, 6.4, layout=None)
    ax: Any = figure.add_axes((0.0, 0.02, 0.94, 0.92), projection="3d", computed_zorder=False)
    look = {"color": FILL, "edgecolor": PALE, "linewidth": 0.3, "shade": False}
    for region in surrogate.domain.regions:
        surface = _surface(surrogate, region, "velocity_ratio")
        some = np.ix_(*[np.linspace(0, n - 1, 25).astype(int) for n in surface[0].shape])  # four-sided faces alone
        ax.plot_surface(*[values[some] for values in surface], rstride=1, cstride=1, **look)
    kinds = _kinds_of_case(database)
    names = ("capillary_number", "size_ratio", "velocity_ratio")
    for name, marker in _BRANCH_STYLES.items():
        points = [database[column][kinds[name]] for column in names]
        ax.plot(*points, linestyle="none", markersize=3.5, label=name, **marker)
    ax.set(**dict(zip(("xlabel", "ylabel", "zlabel"), map(style.ratio_label, names), strict=True)))
    ax.view_init(elev=30.0, azim=130.0)
    ax.legend(loc="upper right", frameon=False)
    return _titled(figure, database)


# The table of shapes: profiles between the walls, Ca to the right and a/l upward


def table_of_cases(database: Database) -> tuple[Floats, Floats]:
    """Choose Ca (k,) and a/l (m,) of the table: common ones nearest to even steps of sqrt(Ca) and of a/l."""
    cases = database.converged
    ca, counts = np.unique(cases["capillary_number"], return_counts=True)
    sizes = np.unique(np.round(cases["size_ratio"], 6))
    return ca[_spread(np.sqrt(ca), counts, _COLUMNS)], sizes[_spread(sizes, np.ones(len(sizes), dtype=int), _ROWS)]


def _spread(values: Floats, counts: Integers, steps: int) -> Integers:
    """Indices of the rising values nearest to even steps, out of those at least half as common as any other there."""
    distance = np.abs(values[:, None] - np.linspace(values[0], values[-1], steps))
    owner = np.argmin(distance, axis=1)
    rare = [2 * count < counts[owner == step].max() for count, step in zip(counts, owner, strict=True)]
    distance[rare] = np.inf
    return np.array([np.argmin(np.where(owner == step, distance[:, step], np.inf)) for step in np.unique(owner)])


def cases_of_cell(database: Database, capillary_numbers: Floats, column: int, size_ratio: float) -> Booleans:
    """Select the cases of a cell : (c,) array, those of its a/l at the Ca nearest, in sqrt(Ca), to its column's."""
    ca = database["capillary_number"]
    distance = np.abs(np.sqrt(ca)[:, None] - np.sqrt(capillary_numbers))
    in_cell = (np.round(database["size_ratio"], 6) == size_ratio) & (np.argmin(distance, axis=1) == column)
    nearest = np.min(distance[in_cell, column], initial=np.inf)
    return in_cell & (distance[:, column] == nearest)


def shapes_figure(database: Database) -> Figure:
    """Draw profiles in the plane x = 0 between the walls, lengths over l; those of all values of an effect together."""
    ca, sizes = table_of_cases(database)
    values = database.values
    several = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, len(values)))
    inks: list[Any] = list(several) if len(values) > 1 else [INK]
    along = database["profile"][..., 0]
    ends = float(np.nanmin(along)) - 0.1, float(np.nanmax(along)) + 0.1
    figure = style.new_figure(9.6, 1.0 + 9.0 * len(sizes) / len(ca) * 2.3 / (ends[1] - ends[0]))
    axes = figure.subplots(len(sizes), len(ca), squeeze=False, sharex=True, sharey=True)
    for (row, column), ax in np.ndenumerate(axes):
        size = sizes[-1 - row]
        style.draw_walls(ax, ends, _OUTSIDE)
        ax.set(xlim=ends, ylim=(-_OUTSIDE, _OUTSIDE), aspect="equal", xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
        _draw_cell(ax, database, cases_of_cell(database, ca, column, size), float(ca[column]), inks)
        if row == 0:
            ax.set_title(rf"$\mathrm{{Ca}}$ = {ca[column]:g}", fontsize=11)
        if column == 0:
            ax.set_ylabel(rf"$a/\ell$ = {size:g}", fontsize=11)
    if database.effect != NO_EFFECT:
        for value, ink in zip(values, inks, strict=True):
            axes[0, 0].plot([], [], color=ink, label=_of_effect(database, value))
        style.legend_below(figure, axes[0, 0], 3)
    return _titled(figure, database, "; flow to the right")


def _draw_cell(ax: Axes, database: Database, in_cell: Booleans, heading_ca: float, inks: list[Any]) -> None:
    """Draw the shapes of a cell; write why it is empty, and its Ca where it differs from that above the table."""
    for row in np.flatnonzero(in_cell & (database["status"] == Status.DONE.name)):
        ink = inks[np.searchsorted(database.values, database["effect_value"][row])]
        fill = FILL if len(inks) == 1 else "none"
        ax.fill(*database["profile"][row].T, facecolor=fill, edgecolor=ink, linewidth=1.3)
    kinds = [name for name, rows in _kinds_of_case(database).items() if (rows & in_cell).any()]
    ca = database["capillary_number"][in_cell]
    words = [f"Ca = {ca[0]:.4g}"] if ca.size and ca[0] != heading_ca else []
    if not set(_BRANCH_STYLES) & set(kinds):
        words.append(textwrap.fill(kinds[0] if kinds else "not in the database", 16))
    ax.text(0.5, 0.5, "\n".join(words), transform=ax.transAxes, ha="center", va="center", color=_FAINT, fontsize=9)


# What an effect changes


def changes(database: Database, value: float) -> pd.DataFrame:
    """Return Ca, a/l and the relative changes of `ERRING` by an effect, of cases that its null value has too."""
    case = ["capillary_number", "size_ratio"]
    changed, null = (
        pd.DataFrame({name: cases[name] for name in (*case, *ERRING)})
        for cases in (database.at_value(each).converged for each in (value, database.null_value))
    )
    both = changed.merge(null, on=case, suffixes=("", "_null"))
    return both[case].assign(**{name: both[name] / both[f"{name}_null"] - 1.0 for name in ERRING})


def changes_figure(database: Database) -> Figure:
    """Draw the changes of L_z, L_a and v_o/U by an effect, a row for each value, a scale for each quantity."""
    changed = {value: changes(database, value) for value in database.values if value != database.null_value}
    figure = style.new_figure(9.6, 1.9 + 2.3 * len(changed))
    axes = figure.subplots(len(changed), len(ERRING), squeeze=False, sharex=True, sharey=True)
    for column, name in zip(axes.T, ERRING, strict=True):
        largest = 100.0 * max(np.max(np.abs(cases[name].to_numpy()), initial=1e-6) for cases in changed.values())
        look: dict[str, Any] = {"vmin": -largest, "vmax": largest, "cmap": "PuOr", "s": 26, "edgecolors": _FAINT}
        for ax, cases in zip(column, changed.values(), strict=True):
            _prepare_plane(ax, database)
            ax.label_outer()
            places = cases["capillary_number"], cases["size_ratio"]
            drawn = ax.scatter(*places, c=100.0 * cases[name], linewidths=0.4, **look)
        label = f"change of ${PARAMETERS[name].latex}$ [%]"
        figure.colorbar(drawn, ax=list(column), location="bottom", label=label, aspect=30)
    for ax, value in zip(axes[:, 1], changed, strict=True):
        ax.set_title(_of_effect(database, value), fontsize=11)
    return _titled(figure, database, f"; change from {_of_effect(database, database.null_value)}")


# Leave-one-out errors of a surrogate over (Ca, a/l), as in the paper's figure 11


def heat_maps(*studies: LeaveOneOut) -> Figure:
    """Draw a row of three maps (Ca, a/l, v_o/U) for each study, with one colour scale a column."""
    figure = style.new_figure(13.0, 3.9 * len(studies))
    axes = figure.subplots(len(studies), 3, squeeze=False, sharex=True, sharey=True)
    for column in range(3):
        largest = np.nanmax(np.concatenate([study.errors[:, column] for study in studies]))
        for ax, study in zip(axes[:, column], studies, strict=True):
            _draw_errors(ax, study, column, LogNorm(_SMALLEST, max(largest, 10 * _SMALLEST)))
    return figure


def _draw_errors(ax: Axes, study: LeaveOneOut, column: int, norm: LogNorm) -> None:
    """Draw the relative error of one parameter, and the dashed line on which Lambda = 1.04."""
    ca, size = study.truth[:, 0], study.truth[:, 1]
    known = np.isfinite(study.errors[:, column])
    colours = np.maximum(study.errors[known, column], _SMALLEST)
    triangles = _triangles(ca[known], size[known])
    drawn = ax.tripcolor(triangles, colours, norm=norm, shading="gouraud", cmap="viridis", rasterized=True)
    ax.plot(ca, size, ".", color="white", markersize=1.5, alpha=0.7)
    stretch = study.stretch_ratio
    if stretch.min() < STRETCH_LIMIT < stretch.max():
        ax.tricontour(_triangles(ca, size), stretch, levels=[STRETCH_LIMIT], colors="black", linestyles="dashed")
    symbol = PARAMETERS[("capillary_number", "size_ratio", "velocity_ratio")[column]].latex
    ax.set_title(f"{study.method}: relative error of ${symbol}$", fontsize=10)
    ax.set(xlabel=r"$\mathrm{Ca}$", ylabel=r"$a/\ell$")
    ax.label_outer()
    ax.figure.colorbar(drawn, ax=ax)


def _triangles(ca: Floats, size: Floats) -> Triangulation:
    """Delaunay triangles of the scaled points, without the long ones that bridge the bays of the domain."""
    x, y = ca / np.ptp(ca), size / np.ptp(size)
    scaled = Triangulation(x, y)
    corners = np.stack([x, y], axis=1)[scaled.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    typical = np.quantile(edges, 0.9)
    return Triangulation(ca, size, scaled.triangles, mask=edges > max(_LONGEST_EDGE, 2.5 * typical))
