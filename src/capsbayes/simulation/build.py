"""Building a database: columns of cases in parallel, each finished case kept, nothing lost by a kill."""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing
import os
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

import capsbayes
from capsbayes.database import VARIABLES, Database
from capsbayes.errors import InputError
from capsbayes.simulation.column import OUTLINE_POINTS, Border, Runs, SteadySimulator, walk
from capsbayes.simulation.mesh_error import chosen_cases, mesh_error
from capsbayes.simulation.parts import Outcome, Parts

__all__ = ["build_database"]

_logger = logging.getLogger(__name__)

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

T = TypeVar("T")
Case = tuple[float, float]
Column = tuple[list[Outcome], Border | None]


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
    ordered = _checked(cases)
    parts = Parts.open(Path(f"{os.fspath(out)}.parts"), simulator.settings)
    size_ratios = sorted({size_ratio for _, size_ratio in ordered})
    columns = [
        partial(_run_column, simulator, parts, size, [ca for ca, other in ordered if other == size])
        for size in size_ratios
    ]
    with _progress_bar(parts, ordered, show=progress):
        results = _computed(columns, scheduler, workers)
    _tell_what_was_raised(results)
    pedigree = _pedigree(simulator.settings)
    if compare is not None:
        pedigree |= {"mesh_error": _compared(simulator, parts, results, compare, scheduler, workers)}
    database = _gathered(results, simulator.settings, pedigree)
    database.write(out)
    return database


def _checked(cases: Iterable[Case]) -> list[Case]:
    ordered = sorted({(float(size), float(ca)) for ca, size in cases})
    if not ordered:
        raise InputError("cases", "", "at least one case (capillary number, size ratio)", "none")
    for size, ca in ordered:
        if not (0.0 < size < np.inf and 0.0 < ca < np.inf):
            raise InputError("cases", "", "positive capillary numbers and size ratios", f"Ca = {ca}, a/l = {size}")
    return [(ca, size) for size, ca in ordered]


def _run_column(simulator: SteadySimulator, parts: Parts, size_ratio: float, capillary_numbers: list[float]) -> Column:
    run = Runs(simulator, parts, size_ratio)
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    with threadpool_limits(limits=1):
        border = walk(run, capillary_numbers)
    return [run.final[value] for value in sorted(capillary_numbers)], border


def _computed(columns: Sequence[Callable[[], T]], scheduler: str | None, workers: int | None) -> list[T]:
    if scheduler == "synchronous":
        return [column() for column in columns]
    if scheduler is not None:
        with _cluster(scheduler) as client:
            return list(client.gather([client.submit(column, pure=False) for column in columns]))
    import dask

    tasks = [dask.delayed(column, pure=False, traverse=False)() for column in columns]
    with _one_thread_each():
        return list(
            dask.compute(
                *tasks,
                scheduler="processes",
                num_workers=workers,
                chunksize=1,  # columns differ much in length, so each worker takes one at a time
                initializer=_end_with_the_build,
            )
        )


def _cluster(address: str) -> Any:
    from distributed import Client

    try:
        # not the process's default: xarray would ask a client that never connected for its locks
        return Client(address, timeout=10.0, set_as_default=False)
    except (OSError, RuntimeError, ValueError) as error:  # no one there, or no address at all
        reason = " ".join(str(error).split())[:120]
        raise InputError("scheduler", "", "address of a running dask scheduler", f"{address!r} ({reason})") from error


def _end_with_the_build() -> None:
    """Let this worker process end when the build is killed; otherwise it waits for work for ever."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Environment of the worker processes while they start: one thread for each."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _progress_bar(parts: Parts, cases: list[Case], *, show: bool) -> Iterator[None]:
    """Bar that counts finished cases in the work folder, so that it sees every worker's."""
    if not (show and sys.stderr.isatty()):
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    layout = (BarColumn(), MofNCompleteColumn(), TextColumn("cases, {task.fields[failed]} without a steady state"))
    over = threading.Event()
    with Progress(*layout, TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("cases", total=len(cases), failed=0)

        def count() -> None:
            ended, failed = parts.tally(cases)
            bar.update(task, completed=ended, failed=failed)

        def keep_counting() -> None:
            while not over.wait(1.0):
                count()

        counter = threading.Thread(target=keep_counting, daemon=True)
        counter.start()
        try:
            yield
        finally:
            over.set()
            counter.join()
            count()


def _compared(
    simulator: Any, parts: Parts, columns: list[Column], refinement: int, scheduler: str | None, workers: int | None
) -> str:
    """Mesh error of some of the cases beside a finer mesh; its runs are kept in a folder within the parts'."""
    finer = simulator.refined(refinement)
    kept = Parts.open(parts.folder / f"refinement-{refinement}", finer.settings)
    coarse = chosen_cases([column for column, _ in columns])
    fine = _computed([partial(_run_again, finer, kept, outcome) for outcome in coarse], scheduler, workers)
    return mesh_error(refinement, coarse, fine)


def _run_again(simulator: SteadySimulator, parts: Parts, outcome: Outcome) -> Outcome:
    """The case of `outcome` by another simulator, started from its steady state."""
    with threadpool_limits(limits=1):
        return Runs(simulator, parts, outcome.size_ratio)(outcome.capillary_number, outcome)


def _gathered(columns: list[Column], settings: Mapping[str, Any], pedigree: Mapping[str, Any]) -> Database:
    """One database of all columns, in their order; what a case lacks is NaN, or 0 for an integer."""
    outcomes = [outcome for column, _ in columns for outcome in column]
    borders = [border for _, border in columns if border is not None]
    outline = (OUTLINE_POINTS, 2)
    shapes: dict[str, tuple[int, ...]] = {"nodes": (0, 3), "profile": outline, "silhouette": outline}
    shapes |= {name: np.shape(value) for outcome in outcomes for name, value in outcome.variables.items()}
    rows: dict[str, list[Any]] = {name: [] for name, variable in VARIABLES.items() if variable.dims[0] == "case"}
    for outcome in outcomes:
        known = outcome.variables | {
            "capillary_number": outcome.capillary_number,
            "size_ratio": outcome.size_ratio,
            "status": outcome.status.name,
            "refinement": int(settings["refinement"]),
        }
        for name, values in rows.items():
            lacking = 0 if VARIABLES[name].kind == "i" else np.full(shapes.get(name, ()), np.nan)
            values.append(known.get(name, lacking))
    border_columns = {f"border_{name}": [getattr(border, name) for border in borders] for name in Border._fields}
    return Database.assemble(rows | border_columns, pedigree)


def _pedigree(settings: Mapping[str, Any]) -> dict[str, Any]:
    law, section = settings["law"], settings["section"]
    return {
        "title": f"Steady shapes of capsules with a {law} membrane in a channel of {section} section",
        "source": "capsbayes, boundary integrals for the liquids and finite elements for the membrane",
        "law": law,
        "section": section,
        "bending": float(settings["bending"]),
        "pre_inflation": float(settings["pre_inflation"]),
        "settings": json.dumps(dict(settings), sort_keys=True),
        "version": capsbayes.__version__,
        "created": _now(),
    }


def _now() -> str:
    """Time of the build, or the one the environment prescribes for reproducible files."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    moment = datetime.fromtimestamp(int(seconds), UTC) if seconds else datetime.now(UTC)
    return moment.isoformat(timespec="seconds")


def _tell_what_was_raised(columns: list[Column]) -> None:
    messages = Counter(outcome.message for column, _ in columns for outcome in column if outcome.message)
    for message, count in messages.most_common():
        _logger.warning("%d cases broke off with %s", count, message)
