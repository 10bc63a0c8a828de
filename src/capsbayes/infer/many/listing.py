"""The capsules of a run, of a folder, of a table or of a file of outlines, as tasks."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import PICTURES, InputFile
from capsbayes.infer.inputs import LOOSEST_VELOCITY
from capsbayes.infer.many.run import Run
from capsbayes.infer.many.tasks import (
    FileTask,
    OutlinesTask,
    RowsTask,
    TableTask,
    measured_file,
    prior_of_file,
)
from capsbayes.infer.prior import Prior
from capsbayes.measured_outline import MID_PLANE, SILHOUETTE, check_view
from capsbayes.measurement import Measurement
from capsbayes.measurements import read_set
from capsbayes.measurements.folder import is_recording, measurement_files
from capsbayes.measurements.netcdf import opened
from capsbayes.measurements.table import SHEETS, MeasuredLengths, is_table_of_lengths
from capsbayes.work import Store

ROWS = 250
"""Of a table in one task: a fraction of a second of work, on the table of the model."""
_EXACT_ROWS = 8
"""Of a table or a file of outlines in one task that takes the exact engine: some seconds of work."""


@dataclass(frozen=True, eq=False)
class Listed:
    """The capsules of a run.

    Parameters
    ----------
    tasks : list of RowsTask
        In the order of the rows.
    measurement : callable
        From the number of a row to what was measured.
    prior : callable
        From the number of a row to its prior.
    """

    tasks: list[RowsTask]
    measurement: Callable[[int], Measurement]
    prior: Callable[[int], Prior]


def listed(source: Path | MeasuredLengths, run: Run, store: Store) -> Listed:
    """List the capsules of a run.

    Parameters
    ----------
    source : Path or MeasuredLengths
        A folder of measurement files and pictures, a table of lengths (.csv, .xlsx, .parquet, .nc), a file of
        outlines (.nc).
    run : Run
    store : Store
        Where the rows are kept.

    Raises
    ------
    InputError
        If there is nothing to identify, or a table comes without its experiment.
    """
    if isinstance(source, MeasuredLengths):
        _check_experiment(run, source.source)
        return _table(source, run, store)
    _check_there(source)
    if source.is_dir():
        files = capsule_files(source)
        if not files:
            expected = f"a folder with measurement files (.toml) or pictures ({', '.join(PICTURES)})"
            raise InputError(str(source), "", expected, "a folder without any")
        return Listed(
            [FileTask(store, file, _name_in(source, file)) for file in files],
            lambda row: measured_file(files[row], run),
            lambda row: prior_of_file(files[row], run.prior),
        )
    if source.suffix not in (*SHEETS, ".parquet", ".nc"):
        expected = "a folder, a .csv, .xlsx, .parquet or .nc file"
        raise InputError(str(source), "", expected, f"a file that ends in {source.suffix or 'nothing'}")
    _check_experiment(run, str(source))
    if is_table_of_lengths(source):
        return _table(MeasuredLengths.read(source), run, store)
    found = read_set(source, run.experiment)
    seen = found.measurements
    tasks: list[RowsTask] = [
        OutlinesTask(store, seen[first : first + _EXACT_ROWS]) for first in range(0, len(seen), _EXACT_ROWS)
    ]
    if found.left_out:
        tasks.append(OutlinesTask(store, (), found.left_out))
    return Listed(tasks, lambda row: seen[row], lambda row: run.prior)


def _check_experiment(run: Run, source: str) -> None:
    if run.experiment is None:
        advice = "say which with experiment=..., or --experiment"
        raise InputError(source, "experiment", "the experiment of the capsules", "nothing", advice)


def _table(measured: MeasuredLengths, run: Run, store: Store) -> Listed:
    """List the rows of a table; a velocity or flow rate that is hardly known is refused."""
    for name, (value, error) in (("capsule_velocity", measured.velocities.T), ("flow_rate", measured.rates.T)):
        expected = f"a standard error below {LOOSEST_VELOCITY:.0%} of the {name.rpartition('_')[2]}"
        measured = measured.refused(error > LOOSEST_VELOCITY * value, f"{name}_error", expected)
    rows = _EXACT_ROWS if run.model.coordinates or run.prior.is_general else ROWS
    tasks: list[RowsTask] = [
        TableTask(store, measured.taken(slice(first, first + rows))) for first in range(0, len(measured), rows)
    ]
    return Listed(tasks, measured.measurement, lambda row: run.prior.with_texts(measured.prior_texts(row)))


def _name_in(folder: Path, file: Path) -> str:
    """Return the name of the capsule of a file: FILM/capsule-1 where several films left folders within the folder."""
    if file.name != "measurement.toml":
        return file.stem
    within = file.parent.relative_to(folder).as_posix()
    return folder.resolve().name if within == "." else within


def capsule_files(folder: Path) -> list[Path]:
    """Return measurement files and pictures of a folder, and measurement files further down, as of films.

    Raises
    ------
    InputError
        If a film or an .rtdc file in the folder is not measured yet.
    """
    return [*measurement_files(folder), *pictures_of(folder)]


def pictures_of(folder: Path) -> list[Path]:
    """Return the pictures of a folder, films among them excepted."""
    named = [file for file in sorted(folder.iterdir()) if file.suffix.lower() in PICTURES]
    return [file for file in named if not is_recording(file)]


def common_experiment(source: Path) -> Experiment | None:
    """Return the experiment that all measurement files of a folder name, None if they name several or none."""
    if not source.is_dir() or not (files := capsule_files(source)):
        return None
    named: set[Path | None] = set()
    for file in files:
        with contextlib.suppress(InputError):  # a damaged file is refused by name later
            stated = None if file.suffix.lower() in PICTURES else InputFile.read(file).content.get("experiment")
            named.add((file.parent / stated).resolve() if isinstance(stated, str) else None)
    only = named.pop() if len(named) == 1 else None
    return None if only is None or not only.is_file() else Experiment.read(only)


def cross_section_and_view(source: Path, experiment: Experiment | None) -> tuple[str, str]:
    """Return cross-section of the channel and view of the outlines, by the first capsule that states them.

    Parameters
    ----------
    source : Path
        As of `listed`.
    experiment : Experiment, optional
        Replaces that which the capsules name.

    Raises
    ------
    InputError
        If nothing is there, or nothing states the cross-section: naming the first capsule that cannot be read, if any.
    """
    _check_there(source)
    view, refused = MID_PLANE, None
    if source.is_dir():
        files = capsule_files(source)
        for file in files:
            try:
                if file.suffix.lower() in PICTURES:
                    view = SILHOUETTE
                    break
                measurement = Measurement.read(file)
                experiment = experiment or (
                    Experiment.read(measurement.experiment_file) if measurement.experiment_file else None
                )
                if measurement.outline is not None:
                    view = measurement.outline.view
                    break
            except InputError as error:
                refused = refused or error
    elif source.suffix == ".nc" and not is_table_of_lengths(source):
        view = check_view(opened(source).attrs.get("view", MID_PLANE), str(source), "view")
    if experiment is None:
        if refused is not None:
            raise refused
        advice = "say which with --experiment"
        raise InputError(str(source), "experiment", "the experiment of the capsules", "nothing", advice)
    return experiment.cross_section, view


def _check_there(source: Path) -> None:
    if not source.exists():
        raise InputError(str(source), "", "a folder, a table of lengths or a file of outlines", "nothing there")
