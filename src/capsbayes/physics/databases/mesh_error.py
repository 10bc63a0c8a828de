"""Differences between the cases of a database and those of a finer mesh."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from capsbayes.physics.databases.outcome import Outcome

QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio")

_PLACES = ((0.1, 0.3), (0.3, 0.8), (0.5, 0.5), (0.7, 0.2), (0.9, 0.7))
"""Ranks of the compared cases: of the sweep among the sweeps, and of the case within its sweep."""


def chosen_cases(sweeps: Sequence[Sequence[Outcome]]) -> list[Outcome]:
    """Choose five converged cases spread over sweeps of rising size and Ca, fewer if there are not enough sweeps."""
    converged = [[outcome for outcome in sweep if outcome.done] for sweep in sweeps]
    filled = [sweep for sweep in converged if sweep]
    chosen = {}
    for across, along in _PLACES if filled else ():
        sweep = filled[round(across * (len(filled) - 1))]
        outcome = sweep[round(along * (len(sweep) - 1))]
        chosen[outcome.size_ratio, outcome.capillary_number] = outcome
    return [chosen[key] for key in sorted(chosen)]


def mesh_error(refinement: int, coarse: Sequence[Outcome], fine: Sequence[Outcome]) -> str:
    """Return relative differences from a finer mesh as JSON: rms over the cases of each quantity, and every case's."""
    rows = [
        {"capillary_number": ours.capillary_number, "size_ratio": ours.size_ratio}
        | {name: ours.variables[name] / finer.variables[name] - 1 for name in QUANTITIES}
        for ours, finer in zip(coarse, fine, strict=True)
        if finer.done
    ]
    squares = {name: np.mean([row[name] ** 2 for row in rows]) if rows else np.nan for name in QUANTITIES}
    summary = {name: float(np.sqrt(value)) for name, value in squares.items()}
    return json.dumps(summary | {"refinement": refinement, "cases": rows}, sort_keys=True)
