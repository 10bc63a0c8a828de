"""Gather the outcomes of sweeps in one database with its pedigree."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

import capsbayes
from capsbayes.database import NO_EFFECT, VARIABLES, Database
from capsbayes.physics.databases.outcome import OUTLINE_POINTS
from capsbayes.physics.databases.sweep import Border, Sweep

_OUTLINE = (OUTLINE_POINTS, 2)
_SHAPES: dict[str, tuple[int, ...]] = {"nodes": (0, 3), "profile": _OUTLINE, "silhouette": _OUTLINE}


def gathered(
    sweeps: Mapping[float, list[Sweep]],
    settings: Mapping[str, Any],
    attributes: Mapping[str, str | int | float],
) -> Database:
    """Return one database of all sweeps by value of the effect; what a case lacks is NaN, or 0 for an integer."""
    # An effect database is compact: it serves for differences, and has ten times the cases.
    by_value = [(value, sweep) for value, several in sweeps.items() for sweep in several]
    outcomes = [(value, outcome) for value, sweep in by_value for outcome in sweep.outcomes]
    borders = [(value, border) for value, sweep in by_value for border in sweep.borders]
    shapes = dict(_SHAPES)
    for _, outcome in outcomes:
        shapes |= {name: np.shape(value) for name, value in outcome.variables.items()}
    rows: dict[str, list[Any]] = {name: [] for name, variable in VARIABLES.items() if variable.dims[0] == "case"}
    for value, outcome in outcomes:
        known = outcome.variables | {
            "capillary_number": outcome.capillary_number,
            "size_ratio": outcome.size_ratio,
            "effect_value": value,
            "status": outcome.status.name,
            "refinement": int(settings["refinement"]),
        }
        for name, values in rows.items():
            lacking = 0 if VARIABLES[name].kind == "i" else np.full(shapes.get(name, ()), np.nan)
            values.append(known.get(name, lacking))
    border_columns = {f"border_{name}": [getattr(border, name) for _, border in borders] for name in Border._fields}
    border_columns["border_effect_value"] = [value for value, _ in borders]
    database = Database.assemble(rows | border_columns, attributes)
    return database if attributes["effect"] == NO_EFFECT else database.compact()


def pedigree(settings: Mapping[str, Any], effect: str = NO_EFFECT, null_value: float = 0.0) -> dict[str, Any]:
    """Return the attributes of a database made now by this version, with the simulator's settings at the null value."""
    law, cross_section = settings["law"], _shown_cross_section(settings)
    channel = f"a channel of {cross_section} cross-section"
    varied = "" if effect == NO_EFFECT else f", over {effect.replace('_', ' ')}"
    return {
        "title": f"Steady shapes of capsules with a {law} membrane in {channel}{varied}",
        "source": "capsbayes, boundary integrals for the liquids and finite elements for the membrane",
        "law": law,
        "cross_section": cross_section,
        "bending": float(settings["bending"]),
        "pre_inflation": float(settings["pre_inflation"]),
        "effect": effect,
        "null_value": float(null_value),
        "settings": json.dumps(dict(settings), sort_keys=True),
        "version": capsbayes.__version__,
        "created": _now(),
    }


def _shown_cross_section(settings: Mapping[str, Any]) -> str:
    """Return the cross-section; a rectangle of equal sides is a square, whatever symmetry it was computed with."""
    name = str(settings["cross_section"])
    return "square" if name == "rectangular" and settings.get("section_aspect") == 1.0 else name


def _now() -> str:
    """Return the time of the build, or the one that the environment prescribes for reproducible files."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    moment = datetime.fromtimestamp(int(seconds), UTC) if seconds else datetime.now(UTC)
    return moment.isoformat(timespec="seconds")
