"""The atlas of a database: what it covers, and what its shapes are, as figures."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from capsbayes.database import NO_EFFECT, Database
from capsbayes.errors import DatabaseError
from capsbayes.show.atlas_changes import changes_figure
from capsbayes.show.atlas_maps import lengths_figure, velocity_figure, velocity_surface_figure
from capsbayes.show.atlas_plane import cases_figure
from capsbayes.show.atlas_shapes import shapes_figure
from capsbayes.surrogate import Surrogate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["atlas"]


def atlas(database: Database) -> dict[str, Figure]:
    """Draw the figures of a database.

    Parameters
    ----------
    database : Database

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
