"""Building a database: columns of cases in parallel, each finished case kept, nothing lost by a kill."""

from __future__ import annotations

import logging
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.physics.simulation.column import Runs, SteadySimulator, walk
from capsbayes.physics.simulation.gather import Column, gathered, pedigree
from capsbayes.physics.simulation.mesh_error import chosen_cases, mesh_error
from capsbayes.physics.simulation.outcome import Outcome, count_ended
from capsbayes.work import Store, progress_bar, run_tasks

__all__ = ["build_database", "checked_cases", "column_tasks", "run_columns"]

_logger = logging.getLogger(__name__)

Case = tuple[float, float]


def build_database(
    simulator: SteadySimulator,
    cases: Iterable[Case],
    *,
    out: str | os.PathLike[str],
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
    compare: int | None = None,
) -> Database:
    """Simulate many cases and write them as one database.

    Finished cases are kept in the folder ``<out>.parts``. The same call made
    again, after a kill or with more cases, computes only what is missing; the
    result does not depend on interruptions or on the number of workers. A case
    that fails is a row with its status.

    Parameters
    ----------
    simulator : Simulator
        Must be picklable.
    cases : iterable of (capillary_number, size_ratio)
        In any order; cases of one size ratio are run one after the other.
    out : path
        The NetCDF file to write.
    scheduler : str, optional
        Address of a dask cluster (``"tcp://host:port"``) that sees the same
        files, or ``"synchronous"`` for this process alone. By default, worker
        processes on this machine.
    workers : int, optional
        Number of worker processes on this machine; by default, one for each core.
    progress : bool
        Whether to show a progress bar, on a terminal only.
    compare : int, optional
        Refinement of a finer mesh on which five of the cases are run again; the differences are kept in the
        attribute ``mesh_error``. The simulator then needs a method ``refined(refinement)``.

    Returns
    -------
    Database
        As written, sorted by size ratio, then capillary number.

    Raises
    ------
    InputError
        If there are no cases, or one is not positive, or no cluster answers.
    DatabaseError
        If ``<out>.parts`` was made with other settings.
    """
    ordered = checked_cases(cases)
    store = Store.open(Path(f"{os.fspath(out)}.parts"), simulator.settings)
    tasks = column_tasks(simulator, store, ordered)
    columns = run_columns(tasks, [store], ordered, scheduler, workers, progress=progress)
    attributes = pedigree(simulator.settings)
    if compare is not None:
        attributes |= {"mesh_error": _compared(simulator, store, columns, compare, scheduler, workers)}
    database = gathered({0.0: columns}, simulator.settings, attributes)
    database.write(out)
    return database


def checked_cases(cases: Iterable[Case]) -> list[Case]:
    """The cases without repetition, sorted by size ratio, then capillary number; refused if one is not positive."""
    ordered = sorted({(float(size), float(ca)) for ca, size in cases})
    if not ordered:
        raise InputError("cases", "", "at least one case (capillary number, size ratio)", "none")
    for size, ca in ordered:
        if not (0.0 < size < np.inf and 0.0 < ca < np.inf):
            raise InputError("cases", "", "positive capillary numbers and size ratios", f"Ca = {ca}, a/l = {size}")
    return [(ca, size) for size, ca in ordered]


def column_tasks(simulator: SteadySimulator, store: Store, cases: list[Case]) -> list[Callable[[], Column]]:
    """Return one task for each size ratio of sorted cases, which computes its column or finds it in the store."""
    size_ratios = sorted({size_ratio for _, size_ratio in cases})
    return [
        partial(_run_column, simulator, store, size, [ca for ca, other in cases if other == size])
        for size in size_ratios
    ]


def run_columns(
    tasks: list[Callable[[], Column]],
    stores: list[Store],
    cases: list[Case],
    scheduler: str | None,
    workers: int | None,
    *,
    progress: bool,
) -> list[Column]:
    """Run the tasks of all stores, with a bar that counts the cases, and log each error that broke off cases."""

    def count() -> tuple[int, str]:
        ended, failed = np.sum([count_ended(store, cases) for store in stores], axis=0)
        return int(ended), f"cases, {failed} without a steady state"

    with progress_bar(len(stores) * len(cases), "cases", show=progress, count=count):
        columns = run_tasks(tasks, scheduler, workers)
    messages = Counter(outcome.message for column, _ in columns for outcome in column if outcome.message)
    for message, number in messages.most_common():
        _logger.warning("%d cases broke off with %s", number, message)
    return columns


def _run_column(simulator: SteadySimulator, store: Store, size_ratio: float, capillary_numbers: list[float]) -> Column:
    run = Runs(simulator, store, size_ratio)
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    with threadpool_limits(limits=1):
        borders = walk(run, capillary_numbers)
    return [run.final[value] for value in sorted(run.final)], borders


def _compared(
    simulator: Any, store: Store, columns: list[Column], refinement: int, scheduler: str | None, workers: int | None
) -> str:
    """Mesh error of some of the cases beside a finer mesh; its runs are kept in a folder within that of the parts."""
    finer = simulator.refined(refinement)
    kept = Store.open(store.folder / f"refinement-{refinement}", finer.settings)
    coarse = chosen_cases([column for column, _ in columns])
    fine = run_tasks([partial(_run_again, finer, kept, outcome) for outcome in coarse], scheduler, workers)
    return mesh_error(refinement, coarse, fine)


def _run_again(simulator: SteadySimulator, store: Store, outcome: Outcome) -> Outcome:
    """The case of `outcome` by another simulator, started from its steady state."""
    with threadpool_limits(limits=1):
        return Runs(simulator, store, outcome.size_ratio)(outcome.capillary_number, outcome)
