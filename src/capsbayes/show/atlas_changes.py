"""What an effect does to lengths and velocity: each case beside that of the null value at the same (Ca, a/l)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.database import Database
from capsbayes.parameters import PARAMETERS
from capsbayes.show.atlas_plane import heading, of_effect, prepare_plane

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["changes", "changes_figure"]

Floats = NDArray[np.float64]

_QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")


def changes(database: Database, value: float, name: str) -> tuple[Floats, Floats, Floats]:
    """Relative change of one quantity from the null value to another, over the cases that both have.

    Parameters
    ----------
    database : Database
        Of an effect.
    value : float
        One of its values.
    name : str
        The quantity, as ``"axial_extent"``.

    Returns
    -------
    capillary_number, size_ratio, change : (c,) arrays [-]
    """
    there, null = (database.at_value(one).converged for one in (value, database.null_value))
    places = [list(zip(one["capillary_number"], one["size_ratio"], strict=True)) for one in (there, null)]
    before = dict(zip(places[1], null[name], strict=True))
    both = [row for row, place in enumerate(places[0]) if place in before]
    change = there[name][both] / np.array([before[places[0][row]] for row in both]) - 1.0
    return there["capillary_number"][both], there["size_ratio"][both], change


def changes_figure(database: Database) -> Figure:
    """Draw the changes of L_z, L_a and v_o/U, a row for each value of the effect, a scale for each quantity.

    Parameters
    ----------
    database : Database
        Of an effect.

    Returns
    -------
    Figure
    """
    from matplotlib.figure import Figure

    values = [value for value in database.values if value != database.null_value]
    figure = Figure(figsize=(9.6, 1.9 + 2.3 * len(values)), layout="constrained")
    axes = figure.subplots(len(values), len(_QUANTITIES), squeeze=False, sharex=True, sharey=True)
    for column, name in zip(axes.T, _QUANTITIES, strict=True):
        found = [changes(database, value, name) for value in values]
        largest = 100.0 * max(float(np.abs(change).max(initial=1e-6)) for *_, change in found)
        style: dict[str, Any] = {
            "vmin": -largest,
            "vmax": largest,
            "cmap": "PuOr",
            "s": 26,
            "edgecolors": "#555555",
            "linewidths": 0.4,
        }
        for ax, (ca, size, change) in zip(column, found, strict=True):
            prepare_plane(ax, database).label_outer()
            drawn = ax.scatter(ca, size, c=100.0 * change, **style)
        label = f"change of ${PARAMETERS[name].latex}$ [%]"
        figure.colorbar(drawn, ax=list(column), location="bottom", label=label, aspect=30)
    for ax, value in zip(axes[:, 1], values, strict=True):
        ax.set_title(of_effect(database, value), fontsize=11)
    null = of_effect(database, database.null_value)
    figure.suptitle(f"{heading(database)}; change from {null}", fontsize=11)
    return figure
