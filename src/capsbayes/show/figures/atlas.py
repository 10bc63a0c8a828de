"""The atlas of a database: what it covers, its shapes and maps, and what an effect changes, as figures."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.database import NO_EFFECT, Database
from capsbayes.errors import DatabaseError
from capsbayes.parameters import PARAMETERS
from capsbayes.show.figures.atlas_maps import lengths_figure, velocity_figure, velocity_surface_figure
from capsbayes.show.figures.atlas_plane import cases_figure, heading, of_effect, prepare_plane
from capsbayes.show.figures.atlas_shapes import shapes_figure
from capsbayes.show.figures.style import new_figure
from capsbayes.surrogate import Surrogate

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
