"""Build a database: sweeps in parallel, each finished case kept, nothing lost by an interruption."""

from __future__ import annotations

import logging
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arguments import checked
from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.files.output_file import check_replaceable, guarded
from capsbayes.interruption import keeping
from capsbayes.physics.capsule.parameters import changed, parameters_of
from capsbayes.physics.databases.gather import gathered, pedigree
from capsbayes.physics.databases.grid import Case
from capsbayes.physics.databases.mesh_error import chosen_cases, mesh_error
from capsbayes.physics.databases.outcome import Outcome, count_ended
from capsbayes.physics.databases.sweep import CaseRunner, SteadySimulator, Sweep, sweep
from capsbayes.work import Store, only_run, progress_bar, run_tasks

_logger = logging.getLogger(__name__)
_FEWEST_VALUES = 3  # if one is held out, two still define a slope


@checked
@guarded()
def build_database(
    simulator: SteadySimulator,
    cases: Iterable[Case],
    *,
    out: str | os.PathLike[str],
    effect: str | None = None,
    values: Iterable[float] = (),
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
    compare: int | None = None,
    compact: bool = False,
) -> Database:
    """Simulate many cases and write them as one database.

    Finished cases are kept in the folder ``<out>.parts``. The same call made again, after an interruption or with more
    cases or values, computes only what is missing; the result does not depend on interruptions or on the number of
    workers. A case that fails is a row with its status.

    An effect database has the same cases at each of a few values of one more parameter. It serves for differences from
    the null value on the same mesh, which are added to a database of a finer mesh; so its own mesh may be coarser.

    Parameters
    ----------
    simulator : Simulator
        Must be picklable; for an effect database a dataclass, whose own value of the parameter is the null value.
    cases : iterable of (capillary_number, size_ratio)
        In any order; cases of one size ratio are run one after the other.
    out : path
        The NetCDF file to write.
    effect : str, optional
        Name of a parameter of the simulator, as ``"pre_inflation"``, or of its membrane law, as ``"hardening"``.
    values : iterable of float
        Values of the effect: at least three, the null value among them.
    scheduler : str, optional
        Address of a dask cluster (``"tcp://host:port"``) that sees the same files, or ``"synchronous"`` for this
        process alone. By default, worker processes on this machine.
    workers : int, optional
        Number of worker processes on this machine; by default, one for each core.
    progress : bool
        Whether to show a progress bar, on a terminal only.
    compare : int, optional
        Refinement of a finer mesh on which five of the cases are run again; the differences are stored in the
        attribute ``mesh_error``. The simulator then needs a method ``refined(refinement)``. Not for an effect.
    compact : bool
        Write it as `Database.compact` returns it.

    Returns
    -------
    Database
        As written, sorted by value of the effect, size ratio, capillary number; that of an effect without nodes.

    Raises
    ------
    InputError
        If there are no cases, or one is not positive, there is no such parameter, the values are too few or lack the
        null value, another run writes `out`, or no cluster answers.
    DatabaseError
        If ``<out>.parts`` was made with other settings.
    """
    check_replaceable(Path(out))
    ordered, folder = _checked_cases(cases), Path(f"{os.fspath(out)}.parts")
    varied = {0.0: simulator} if effect is None else _simulators_at(simulator, effect, values)
    with only_run(Path(out)), keeping(folder):
        if effect is None:
            attributes = pedigree(simulator.settings)
            stores = [Store.open(folder, simulator.settings)]
        else:
            attributes = pedigree(simulator.settings, effect, _null_value(simulator, effect))
            stores = [Store.open(folder / f"{effect}-{value!r}", changed.settings) for value, changed in varied.items()]
        tasks = [_sweep_tasks(*of_value, ordered) for of_value in zip(varied.values(), stores, strict=True)]
        sweeps = iter(_run_sweeps(list(chain(*tasks)), stores, ordered, scheduler, workers, progress=progress))
        by_value = {value: list(islice(sweeps, len(some))) for value, some in zip(varied, tasks, strict=True)}
        if compare is not None and effect is None:
            attributes |= {"mesh_error": _compared(simulator, stores[0], by_value[0.0], compare, scheduler, workers)}
        database = gathered(by_value, simulator.settings, attributes)
        if compact:
            database = database.compact()
        database.write(out)
    return database


def _checked_cases(cases: Iterable[Case]) -> list[Case]:
    """Return the cases once each, sorted by size ratio, then capillary number; refuse none or one not positive."""
    ordered = sorted({(float(size), float(ca)) for ca, size in cases})
    if not ordered:
        raise InputError("cases", "", "at least one case (capillary number, size ratio)", "none")
    for size, ca in ordered:
        if not (0.0 < size < np.inf and 0.0 < ca < np.inf):
            raise InputError("cases", "", "positive capillary numbers and size ratios", f"Ca = {ca}, a/l = {size}")
    return [(ca, size) for size, ca in ordered]


def _sweep_tasks(simulator: SteadySimulator, store: Store, cases: list[Case]) -> list[Callable[[], Sweep]]:
    """Return one task for each size ratio of sorted cases."""
    sizes = sorted({size for _, size in cases})
    return [partial(_run_sweep, simulator, store, size, [ca for ca, other in cases if other == size]) for size in sizes]


def _run_sweeps(
    tasks: list[Callable[[], Sweep]],
    stores: list[Store],
    cases: list[Case],
    scheduler: str | None,
    workers: int | None,
    *,
    progress: bool,
) -> list[Sweep]:
    """Run the tasks of all stores, with a bar that counts the cases, and log the errors of the simulator."""

    def count() -> tuple[int, str]:
        ended, failed = np.sum([count_ended(store, cases) for store in stores], axis=0)
        return int(ended), f"cases, {failed} without a steady state"

    with progress_bar(len(stores) * len(cases), "cases", show=progress, count=count):
        sweeps = run_tasks(tasks, scheduler, workers)
    messages = Counter(outcome.message for sweep in sweeps for outcome in sweep.outcomes if outcome.message)
    for message, number in messages.most_common():
        _logger.warning("%d cases broke off with %s", number, message)
    return sweeps


def _run_sweep(simulator: SteadySimulator, store: Store, size_ratio: float, capillary_numbers: list[float]) -> Sweep:
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    with threadpool_limits(limits=1):
        return sweep(CaseRunner(simulator, store, size_ratio), capillary_numbers)


def _compared(
    simulator: Any, store: Store, sweeps: list[Sweep], refinement: int, scheduler: str | None, workers: int | None
) -> str:
    """Return the mesh error of some cases from a finer mesh, whose cases are kept in a folder of their own."""
    finer = simulator.refined(refinement)
    kept = Store.open(store.folder / f"refinement-{refinement}", finer.settings)
    coarse = chosen_cases([sweep.outcomes for sweep in sweeps])
    fine = run_tasks([partial(_run_again, finer, kept, outcome) for outcome in coarse], scheduler, workers)
    return mesh_error(refinement, coarse, fine)


def _run_again(simulator: SteadySimulator, store: Store, outcome: Outcome) -> Outcome:
    """Run the case of `outcome` with another simulator, started from its steady state."""
    with threadpool_limits(limits=1):
        return CaseRunner(simulator, store, outcome.size_ratio).run(outcome.capillary_number, outcome)


def _null_value(simulator: Any, effect: str) -> float:
    """Return the simulator's own value of a parameter, the null value of the effect; refuse an unknown parameter."""
    known = parameters_of(simulator)
    if effect not in known:
        raise InputError("build", "effect", f"one of {', '.join(known)}", repr(effect))
    return known[effect]


def _simulators_at(simulator: Any, effect: str, values: Iterable[float]) -> dict[float, Any]:
    """Return the simulator at each value of a parameter, in rising order; refuse too few, or without the null value."""
    null, ordered = _null_value(simulator, effect), sorted({float(value) for value in values})
    if len(ordered) < _FEWEST_VALUES or null not in ordered:
        expected = f"at least {_FEWEST_VALUES} values of {effect}, the simulator's own {null:g} among them"
        raise InputError("build", "values", expected, ", ".join(f"{value:g}" for value in ordered) or "none")
    return {value: changed(simulator, effect, value) for value in ordered}
