"""From many measured capsules to their posteriors: in parallel, resumable, one row a capsule."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.output_file import check_replaceable, guarded, make_folder, note_input, refusing
from capsbayes.infer.many.capsule_rows import CapsuleRows
from capsbayes.infer.many.distribution.selection import limit_of
from capsbayes.infer.many.listing import Listed, common_experiment, listed
from capsbayes.infer.many.population import STATISTICS, Population
from capsbayes.infer.many.run import Run
from capsbayes.infer.many.sampled import ChainTask, CheckTask, Compared, compared, drawn_rows
from capsbayes.infer.many.tasks import RowsTask, StoredTask
from capsbayes.infer.posterior import REPORTED
from capsbayes.infer.prior import Prior, check_coordinates
from capsbayes.interruption import keeping
from capsbayes.measurements.table import MeasuredLengths
from capsbayes.model import ForwardModel
from capsbayes.quantity import Given, Quantity
from capsbayes.work import Store, only_run, progress_bar, run_tasks
from capsbayes.work.store import check_parts

if TYPE_CHECKING:
    import pandas as pd

_logger = logging.getLogger(__name__)

_ATTEMPTS = 3  # at tasks whose workers are killed


@checked
@guarded()
def identify_folder(
    source: str | os.PathLike[str] | pd.DataFrame,
    model: ForwardModel,
    experiment: Experiment | None = None,
    *,
    out: str | os.PathLike[str],
    seed: int,
    prior: Prior | None = None,
    shared_velocity: Given | None = None,
    flow_rate: Given | None = None,
    background: str | os.PathLike[str] | None = None,
    flow: str | None = None,
    by_hand: Any = None,
    check: float = 0.01,
    most_checked: int = 100,
    chains: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Population:
    """Identify many capsules.

    Finished parts are kept in the folder ``<out>.parts``. The same call made again, after an interruption or with more
    files in the folder, computes only what is missing; the result depends neither on interruptions nor on the number
    of workers. The parts of a table are removed at the end, those of a folder stay.
    A capsule that cannot be identified is a row with its status. Lengths are identified on a table of the model, each
    outline on a grid of its own.

    Parameters
    ----------
    source : path or pandas DataFrame
        A folder of measurement files and pictures, a table of lengths (.csv, .parquet, .nc), a file of outlines (.nc);
        or a DataFrame with the columns of a table, see `capsbayes.measurements.table.MeasuredLengths.read`.
    model : ForwardModel
    experiment : Experiment, optional
        By default the one that each measurement of a folder names.
    out : path
        The NetCDF file to write; a ``.csv`` of the same name is written next to it. Neither replaces `source`, nor a
        file that was not written here, unless within `capsbayes.files.guarded` with ``overwrite=True``.
    seed : int
        Seed of all random numbers; stored in the result.
    prior : Prior, optional
    shared_velocity : Quantity, optional [m/s]
        Velocity that the capsules in pictures share, in any form that `Quantity.of` reads; its error is the spread
        from capsule to capsule, and counts as an independent error of each.
    flow_rate : Quantity, optional [m^3/s]
        Flow rate in the channel of the pictures, with its standard error; no velocity is needed with it.
    background : path, optional
        Picture of the empty channel.
    flow : str, optional
        ``"right"`` or ``"left"``, in pictures.
    by_hand : ByHand, optional
        What is stated of walls, scale and part of all pictures, as `capsbayes.image.ByHand`.
    check : float
        Share of the capsules, drawn at random, that are sampled with emcee too.
    most_checked : int
        Largest number of these: each takes a second or more.
    chains : path, optional
        Folder for the draws of each capsule, sampled with emcee; not kept by default.
    scheduler : str, optional
        Address of a dask cluster (``"tcp://host:port"``) that sees the same files, or ``"synchronous"`` for this
        process alone. By default, worker processes of this machine.
    workers : int, optional
        Number of worker processes; by default, one for each core.
    progress : bool
        Show a progress bar, on a terminal.

    Returns
    -------
    Population

    Raises
    ------
    InputError
        If there is nothing to identify, another run writes `out`, no cluster answers, or the disk is full; finished
        parts are then kept.
    """
    out = Path(out)
    given = Path(source) if isinstance(source, (str, os.PathLike)) else MeasuredLengths.of_frame(source)
    if experiment is None and isinstance(given, Path):
        experiment = common_experiment(given)
    parts = out.with_name(f"{out.name}.parts")
    _check_outputs(given, out, parts)
    where = None if background is None else Path(background)
    speed, rate = (
        None if given_one is None else Quantity.of(given_one, name, where="identify_folder")
        for given_one, name in ((shared_velocity, "capsule_velocity"), (flow_rate, "flow_rate"))
    )
    run = Run(model, experiment, prior or Prior(), seed, speed, rate, where, flow, by_hand)
    check_coordinates(model, run.prior)
    if experiment is not None:
        model.check_experiment(experiment)
    pool = _Pool(run, scheduler, workers, progress)
    store = Store(parts, run.fingerprint)
    with only_run(out), keeping(parts), refusing(parts, "a folder that can be written"):
        found = listed(given, run, store)
        pool.finish(found.tasks, "parts")
        rows = CapsuleRows.joined(map(_read, found.tasks), sum(task.number for task in found.tasks))
        attributes = _attributes(run, str(given) if isinstance(given, Path) else given.source)
        population = Population.of(rows, attributes, limit_of(model))
        population.write(out.with_suffix(".csv"))
        agreement = _checked(population, found, store, check, most_checked, pool)
        if agreement is not None:
            population.dataset.attrs["agreement"] = json.dumps(agreement.as_dict())
        population.write(out)
        if chains is not None:
            make_folder(Path(chains))
            usable = {int(row): str(population["name"][row]) for row in _with_result(population)}
            drawn = [
                ChainTask.of(found.measurement(row), found.prior(row), Path(chains), row, name, run)
                for row, name in usable.items()
            ]
            pool.finish(drawn, "chains")
        if not (isinstance(given, Path) and given.is_dir()):
            shutil.rmtree(parts)
    return population


def _check_outputs(given: Path | MeasuredLengths, out: Path, parts: Path) -> None:
    """Refuse outputs that would replace the source, or a file that was not written here."""
    if isinstance(given, Path):
        note_input(given)
    if out.suffix != ".nc":
        raise InputError("identify_folder", "out", "a file name that ends in .nc", repr(str(out)))
    for path in (out, out.with_suffix(".csv")):
        check_replaceable(path)
    check_parts(parts)


@dataclass(frozen=True)
class _Pool:
    """Scheduler of the tasks."""

    run: Run
    scheduler: str | None
    workers: int | None
    progress: bool

    def finish(self, tasks: Sequence[StoredTask | ChainTask], what: str) -> None:
        """Run the tasks that are not done; again those still missing if a worker was killed."""
        names = {task.file.name for task in tasks}

        def count() -> tuple[int, str]:  # by one look into their folder: there may be a hundred thousand files
            folder = tasks[0].file.parent if tasks else None
            there = os.listdir(folder) if folder is not None and folder.exists() else ()
            return len(names.intersection(there)), what

        with progress_bar(len(names), what, show=self.progress, count=count):
            for attempt in range(_ATTEMPTS):
                missing = [task for task in tasks if not task.done]
                try:
                    run_tasks(missing, self.scheduler, self.workers, self.run)
                    return
                except BrokenProcessPool:
                    left = _ATTEMPTS - attempt - 1
                    _logger.warning("A worker was killed; what is finished is kept. Attempts left: %d.", left)
        advice = "give it more memory or fewer workers, and start again: what is finished is kept"
        raise InputError("workers", "", "workers that run to their end", "one killed at each attempt", advice)


def _read(task: RowsTask) -> CapsuleRows:
    rows = task.rows
    assert rows is not None, "the workers see the same files"
    return rows


def _attributes(run: Run, source: str) -> dict[str, Any]:
    known = run.experiment
    stated: dict[str, Any] = {}
    if known is not None:
        inputs = {"half_width": known.half_width, "viscosity": known.viscosity}
        pairs = {name: {"value": quantity.mean, "error": quantity.sd} for name, quantity in inputs.items()}
        stated = {"cross_section": known.cross_section, **pairs}
    return {
        "title": "posteriors of capsules",
        "source": source,
        "model": run.model.name,
        "model_sha256": run.model.sha256,
        "experiment": json.dumps(stated),
        "prior": json.dumps(run.prior.described()),
        "seed": run.seed,
        "version": __version__,
        "fingerprint": run.fingerprint,
    }


def _with_result(population: Population) -> NDArray[np.intp]:
    return np.flatnonzero(np.isfinite(population["surface_shear_modulus_median"]))


def _checked(
    population: Population, found: Listed, store: Store, share: float, most: int, pool: _Pool
) -> Compared | None:
    """Compare rows with sampling; return None if no capsule can be compared or none shall be."""
    rows = drawn_rows(population.usable, share, most, int(population.dataset.attrs["seed"]))
    if not len(rows):
        return None
    names = [f"{name}_{statistic}" for name in REPORTED for statistic in STATISTICS]
    summaries = np.stack([population[name][rows] for name in names], axis=1).reshape(len(rows), len(REPORTED), -1)
    seed = int(population.dataset.attrs["seed"])
    tasks = [
        CheckTask(store, found.measurement(row), of_row, seed, found.prior(row))
        for row, of_row in zip(map(int, rows), summaries, strict=True)
    ]
    pool.finish(tasks, "capsules sampled")
    return compared([task.differences for task in tasks if task.differences is not None])
