"""A session whose capsules are simulated one by one, each at its own Ca and size."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.evidence.blind.hideable import Hideable
from capsbayes.evidence.blind.lab import Lab
from capsbayes.evidence.blind.pools import simulator_with
from capsbayes.evidence.blind.session import HiddenSession, assembled, capsule_of
from capsbayes.physics.databases.build import build_database

__all__ = ["simulated_session"]

_SPARE = 1.15  # times as many capsules are simulated as are wanted, since some have no steady shape
_DIGITS = 6  # of Ca and a/l, so that a case can be found again
_LOWEST = 0.02  # Ca, below which two shapes may be stable


def simulated_session(
    hidden: Hideable,
    size: float,
    *,
    lab: Lab,
    capsules: int,
    seed: int,
    shapes: str | os.PathLike[str],
    outline: bool = True,
    refinement: int | None = None,
    workers: int | None = None,
) -> HiddenSession:
    """Draw capsules from a lab's population, simulate them, and measure them.

    Parameters
    ----------
    hidden : Hideable
    size : float
        In SI.
    lab : Lab
    capsules : int
    seed : int
    shapes : path
        Database to keep the shapes in; the same call made again takes up what it finds there and beside it.
    outline : bool
        Whether outlines are measured, or lengths alone.
    refinement : int, optional
        Of the mesh.
    workers : int, optional
        Of `build_database`.

    Raises
    ------
    InputError
        If too few of the capsules have a steady shape.
    """
    rng = np.random.default_rng(seed)
    modulus, size_ratio, speed = hidden.lab(lab, size).drawn(rng, int(np.ceil(_SPARE * capsules)))
    number = np.round(np.maximum(lab.viscosity * speed / modulus, _LOWEST), _DIGITS)
    size_ratio = np.round(size_ratio, _DIGITS)
    simulator = simulator_with(hidden, size) if refinement is None else simulator_with(hidden, size, refinement)
    Path(shapes).parent.mkdir(parents=True, exist_ok=True)
    there = build_database(simulator, list(zip(number, size_ratio, strict=True)), out=shapes, workers=workers).converged
    found = [_row(there, *case) for case in zip(number, size_ratio, strict=True)]
    rows = [(row, float(one)) for row, one in zip(found, speed, strict=True) if row is not None][:capsules]
    if len(rows) < capsules:
        advice = "let them be softer or smaller"
        raise InputError("hidden session", "capsules", f"{capsules} with a steady shape", f"{len(rows)}", advice)
    seen = [hidden.drawn(capsule_of(there, row, one, lab), size, lab, seed) for row, one in rows]
    return assembled(seen, hidden, size, lab=lab, seed=seed, outline=outline, rng=rng, shapes=there.sha256)


def _row(shapes: Database, capillary_number: float, size_ratio: float) -> int | None:
    """Row of a case, None if it has no steady shape."""
    same = np.isclose(shapes["capillary_number"], capillary_number) & np.isclose(shapes["size_ratio"], size_ratio)
    rows = np.flatnonzero(same)
    return int(rows[0]) if len(rows) else None
