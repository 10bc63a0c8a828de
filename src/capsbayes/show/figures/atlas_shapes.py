"""A table of the shapes of a database: profiles between the walls, Ca to the right and a/l upward."""

from __future__ import annotations

import textwrap
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.database import NO_EFFECT, Database
from capsbayes.show.figures.atlas_plane import BRANCH_STYLES, heading, kinds_of_case, of_effect
from capsbayes.show.figures.style import FILL, INK, draw_walls, new_figure
from capsbayes.status import Status

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
