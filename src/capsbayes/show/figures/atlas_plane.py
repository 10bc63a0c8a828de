"""The plane (Ca, a/l) of a database: its cases, and the borders of steady shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE, LOST_FROM_REST, NO_EFFECT, SNAP_THROUGH, Database
from capsbayes.show.figures.style import ACCENT, INK, WALL, label_plane, new_figure
from capsbayes.status import Status
from capsbayes.surrogate.plane import CONVEX

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
