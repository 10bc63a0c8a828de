"""How far the cases of a database are from those of a finer mesh."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from capsbayes.physics.simulation.outcome import Outcome
from capsbayes.status import Status

__all__ = ["chosen_cases", "mesh_error"]

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")

_PLACES = ((0.1, 0.3), (0.3, 0.8), (0.5, 0.5), (0.7, 0.2), (0.9, 0.7))
"""Ranks of the compared cases: of the column among the columns, and of the case within its column."""


def chosen_cases(columns: Sequence[Sequence[Outcome]]) -> list[Outcome]:
    """Five converged cases spread over the columns.

    Parameters
    ----------
    columns : sequence of sequences of Outcome
        The cases of each size ratio, both in rising order.

    Returns
    -------
    list of Outcome
        Fewer if there are not enough columns.
    """
    converged = [[outcome for outcome in column if outcome.done] for column in columns]
    filled = [column for column in converged if column]
    chosen = {}
    for across, along in _PLACES if filled else ():
        column = filled[round(across * (len(filled) - 1))]
        outcome = column[round(along * (len(column) - 1))]
        chosen[outcome.size_ratio, outcome.capillary_number] = outcome
    return [chosen[key] for key in sorted(chosen)]


def mesh_error(refinement: int, coarse: Sequence[Outcome], fine: Sequence[Outcome]) -> str:
    """Differences from a finer mesh as JSON: rms over the cases of each quantity, relative, and every case's.

    Parameters
    ----------
    refinement : int
        That of the finer mesh.
    coarse, fine : sequences of Outcome
        The same cases on both meshes.

    Returns
    -------
    str
    """
    rows = [
        {"capillary_number": one.capillary_number, "size_ratio": one.size_ratio}
        | {name: one.variables[name] / other.variables[name] - 1 for name in QUANTITIES}
        for one, other in zip(coarse, fine, strict=True)
        if other.status is Status.DONE
    ]
    squares = {name: np.mean([row[name] ** 2 for row in rows]) if rows else np.nan for name in QUANTITIES}
    summary = {name: float(np.sqrt(value)) for name, value in squares.items()}
    return json.dumps(summary | {"refinement": refinement, "cases": rows}, sort_keys=True)
