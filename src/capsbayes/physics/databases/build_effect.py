"""Build an effect database: the same cases at each of a few values of one more parameter of the simulator.

It serves for differences from the null value on the same mesh, which are added to a database of a finer mesh; so its
own mesh may be coarser.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.physics.databases.build import Case, checked_cases, run_sweeps, sweep_tasks
from capsbayes.physics.databases.gather import gathered, pedigree
from capsbayes.work import Store

__all__ = ["build_effect_database"]

_FEWEST_VALUES = 3  # if one is held out, two still define a slope


def build_effect_database(
    simulator: Any,
    cases: Iterable[Case],
    *,
    effect: str,
    values: Iterable[float],
    out: str | os.PathLike[str],
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Database:
    """Simulate many cases at each value of a parameter and write them as one database.

    Each value has its own folder in ``<out>.parts``; for all else see `build_database`.

    Parameters
    ----------
    simulator : Simulator
        A dataclass; its own value of the parameter is the null value of the effect.
    cases : iterable of (capillary_number, size_ratio)
        Those of each value.
    effect : str
        Name of a parameter of the simulator, as ``"pre_inflation"``, or of its membrane law, as ``"hardening"``.
    values : iterable of float
        At least three, the null value among them.
    out, scheduler, workers, progress
        As in `build_database`.

    Returns
    -------
    Database
        As written, sorted by value, size ratio, capillary number; without nodes.

    Raises
    ------
    InputError
        If there is no such parameter, or the values are too few or lack the null value.
    DatabaseError
        If a folder of ``<out>.parts`` was made with other settings.
    """
    ordered, null_value = checked_cases(cases), _null_value(simulator, effect)
    simulators = {value: _with_value(simulator, effect, value) for value in _checked_values(values, effect, null_value)}
    folder = Path(f"{os.fspath(out)}.parts")
    stores = {value: Store.open(folder / f"{effect}-{value!r}", each.settings) for value, each in simulators.items()}
    tasks = {value: sweep_tasks(each, stores[value], ordered) for value, each in simulators.items()}
    of_all = [task for several in tasks.values() for task in several]
    rest = iter(run_sweeps(of_all, list(stores.values()), ordered, scheduler, workers, progress=progress))
    by_value = {value: [next(rest) for _ in several] for value, several in tasks.items()}
    database = gathered(by_value, simulator.settings, pedigree(simulator.settings, effect, null_value))
    database.write(out)
    return database


def _parameters(owner: Any) -> dict[str, float]:
    """Return the fields of a dataclass that are numbers, but not whole ones."""
    values = {field.name: getattr(owner, field.name) for field in fields(owner)} if is_dataclass(owner) else {}
    return {name: value for name, value in values.items() if isinstance(value, float)}


def _null_value(simulator: Any, effect: str) -> float:
    known = _parameters(simulator) | _parameters(getattr(simulator, "law", None))
    if effect not in known:
        raise InputError("build", "effect", f"one of {', '.join(known)}", repr(effect))
    return known[effect]


def _checked_values(values: Iterable[float], effect: str, null_value: float) -> list[float]:
    ordered = sorted({float(value) for value in values})
    if len(ordered) < _FEWEST_VALUES or null_value not in ordered:
        expected = f"at least {_FEWEST_VALUES} values of {effect}, the simulator's own {null_value:g} among them"
        raise InputError("build", "values", expected, ", ".join(f"{value:g}" for value in ordered) or "none")
    return ordered


def _with_value(simulator: Any, effect: str, value: float) -> Any:
    if effect in _parameters(simulator):
        return replace(simulator, **{effect: value})
    return replace(simulator, law=replace(simulator.law, **{effect: value}))
