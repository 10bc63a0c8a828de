"""Identification of the capsules of a folder or table, resumed after an interruption."""

from __future__ import annotations

import abc
import contextlib
import functools
import hashlib
import json
import logging
import os
import re
import shutil
import time
from collections.abc import Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import CapsbayesError, InputError, NoShapeError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import PICTURES, InputFile, read_bytes
from capsbayes.files.output_file import check_replaceable, guarded, make_folder, note_input, refusing
from capsbayes.infer import identify
from capsbayes.infer.grid import GridPosterior
from capsbayes.infer.identify import check_applies
from capsbayes.infer.importance import ExactEngine, exact_engine
from capsbayes.infer.outline import outline_misfit
from capsbayes.infer.population import COMPONENT, COMPONENTS, LEANINGS, STATISTICS, CapsuleRows, Population, mixture
from capsbayes.infer.posterior import REPORTED, work_of
from capsbayes.infer.prior import LOOSEST_VELOCITY, Inputs, Prior, check_coordinates, refuse_membrane
from capsbayes.infer.selection import limit_of
from capsbayes.infer.verdict import (
    Misfit,
    inertia,
    leanings,
    leanings_at_nodes,
    misfits_of,
    p_values,
    shares_by_kind,
    verdict,
)
from capsbayes.interruption import keeping, raise_interruption
from capsbayes.measurement import MID_PLANE, SILHOUETTE, Measurement, check_view
from capsbayes.measurement_sets import (
    NUMBERS,
    SHEETS,
    MeasuredLengths,
    is_recording,
    is_table_of_lengths,
    known_experiment,
    measurement_files,
    opened,
    read_set,
    unmeasured,
)
from capsbayes.model import ForwardModel
from capsbayes.quantity import Given, Quantity
from capsbayes.run import Store, check_parts, digest_of, only_run, progress_bar, run_tasks, steps_kept
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


# Settings that all capsules of a run share; each worker process gets them once


@dataclass(frozen=True, eq=False)
class Run:
    """Model, experiment and prior of a run."""

    model: ForwardModel
    experiment: Experiment | None  # None: each measurement names its own
    prior: Prior
    seed: int
    capsule_velocity: Quantity | None = None  # [m/s], which capsules in pictures share
    flow_rate: Quantity | None = None  # [m^3/s], in their channel
    background: Path | None = None  # picture of the empty channel
    flow: str | None = None  # ``"right"`` or ``"left"``, in pictures
    by_hand: Any = None  # what is stated of the pictures

    @cached_property
    def _engine(self) -> ExactEngine:
        assert self.experiment is not None
        return exact_engine(self.model, self.experiment, self.prior)

    def engine(self, experiment: Experiment) -> ExactEngine:
        """Return the engine for an experiment; that of the run is kept."""
        return exact_engine(self.model, experiment, self.prior) if self.experiment is None else self._engine

    @cached_property
    def fingerprint(self) -> str:
        """Hash of everything that decides the results, the capsules themselves excepted."""
        background = None if self.background is None else read_bytes(self.background, "picture of the empty channel")
        speeds = self.capsule_velocity, self.flow_rate
        how = self.experiment, self.prior, speeds, self.flow, background, self.by_hand
        return digest_of(__version__, self.model, self.seed, *how)

    def experiment_of(self, measurement: Measurement) -> Experiment:
        """Return the experiment of the run, or that which the measurement names, with the conditions of the capsule."""
        known = self.experiment
        if known is None:
            known = Experiment.read(measurement.named_experiment("name it there, or give one for all"))
        own: dict[str, Any] = {}
        for name, value in measurement.conditions.items():
            usual = getattr(known, name)
            own[name] = Quantity(value, usual.sd * value / usual.mean)
        return replace(known, **own) if own else known


# Row of one capsule by the exact engine

_LEANINGS = tuple(f"leaning_{name}" for name in LEANINGS)
_SHARED = ("viscosity", "half_width")
_DRAWS = 10_000  # from which the mixture and the shares next to borders are computed where nodes do not tell them


def fill_exactly(rows: CapsuleRows, row: int, measurement: Measurement, run: Run) -> None:
    """Identify one capsule by quadrature and fill its row; one that cannot be identified gets a status and a reason."""
    rows["engine"][row] = "grid"
    try:
        _fill(rows, row, measurement, run)
    except InputError as error:
        rows.refuse(row, Status.NO_SHAPE if isinstance(error, NoShapeError) else Status.UNUSABLE, str(error))
        if isinstance(error, NoShapeError):
            rows["distance"][row] = error.distance
    except Exception as error:  # a batch does not stop for one capsule
        raise_interruption(error)
        rows.refuse(row, Status.RAISED, f"{type(error).__name__}: {error}")


def _fill(rows: CapsuleRows, row: int, measurement: Measurement, run: Run) -> None:
    own, seen = run.experiment_of(measurement), measurement.outline
    check_applies(run.model, measurement, own)
    engine = run.engine(own)
    posterior = engine(measurement, inputs=Inputs.of(measurement, own))
    grid = posterior if isinstance(posterior, GridPosterior) and posterior.half_width is None else None
    if grid is None or grid.cut or seen is not None:
        draws = posterior.drawn(np.random.default_rng([run.seed, 1]), _DRAWS)
        leans = leanings(draws, run.model, engine.prior)
    else:
        draws, leans = {}, leanings_at_nodes(grid, engine.prior)
    filled: dict[str, Any] = dict(zip(_LEANINGS, shares_by_kind(leans), strict=True))
    for name in REPORTED:
        filled |= {f"{name}_{statistic}": value for statistic, value in vars(posterior.marginal(name)).items()}
    if grid is not None and seen is None:
        filled["distance"] = grid.distance
    predicted = p_values(engine, measurement, posterior)
    filled |= {f"p_value_{name}": p_value for name, p_value in predicted.items()}
    misfits = misfits_of(predicted)
    if seen is not None:
        misfits.insert(0, Misfit(outline_misfit(seen, run.model, draws), Status.OUTLINE_MISFIT))
    misfits.append(inertia(float(own.reynolds_number(posterior.marginal("mean_velocity").median))))
    filled["reynolds_number"] = misfits[-1].gate.value
    filled["status"] = verdict(posterior.gates, None, leans, misfits, posterior.unresolved).name
    weights, x, y, spread = _likelihood(draws, run, posterior.density.inputs) if grid is None else grid.likelihood
    # a capsule's own viscosity and half width, over those of all, are not among what all share
    of_all = own if run.experiment is None else run.experiment
    shift = [np.log(getattr(own, name).mean / getattr(of_all, name).mean) for name in _SHARED]
    filled["likelihood"] = np.empty((COMPONENTS, len(COMPONENT)))
    mixture(weights, x + shift[0], y + shift[1], filled["likelihood"])
    filled["likelihood"][:, COMPONENT.index("xx")] += spread
    rows.fill(row, filled)


def _likelihood(draws: Mapping[str, Floats], run: Run, inputs: Inputs) -> tuple[Floats, Floats, Floats, float]:
    """Return that of `GridPosterior.likelihood` at draws: the posterior without the priors of G_s and a."""
    moduli, radii = np.log(draws["surface_shear_modulus"]), np.log(draws["capsule_radius"])
    flat = np.exp(-_log_prior(run.prior.surface_shear_modulus, moduli) - _log_prior(run.prior.capsule_radius, radii))
    if inputs.by_flow_rate:  # U is shared too
        moduli -= np.log(draws["mean_velocity"] * run.model.relative_area(draws) / inputs.mean_velocity(1.0))
    viscosity, half_width = np.log([draws[name] for name in _SHARED])
    return flat, moduli - viscosity, radii - half_width, 0.0


def _log_prior(prior: Quantity, logs: Floats) -> Floats:
    """Return the log density of log x, zero where it is highest; a draw beyond a range counts as within it."""
    density = prior.power * logs if prior.is_range else prior.log_weight(np.exp(logs))
    return density - density.max()


def numbers_of(measurement: Measurement) -> dict[str, float]:
    """Return the measured numbers by column, lengths in metres as they are."""
    stated = {name: measurement.conditions.get(name, getattr(measurement, name, None)) for name in NUMBERS}
    return {name: np.nan if number is None else number for name, number in stated.items()}


# Independent tasks of a run, as some rows of a table or one file; the rows of each are one part of a store.
#
# The part is named by a hash of the run and of the content of what was measured, so that it is found again after an
# interruption, and nothing is taken from other settings or from a file that has changed since

_FORMAT = 2  # of the parts: rows by column
_LONGEST_NAME = 250
_LONGEST_UNKEPT = 5.0  # s of work


@dataclass(frozen=True)
class StoredTask(abc.ABC):
    """A task whose result is a part of a store."""

    store: Store
    kind: ClassVar[str]  # first word of the name of the part

    @abc.abstractmethod
    def _contents(self) -> Sequence[Any]:
        """Return what the part is computed from, the settings of the store excepted."""

    @abc.abstractmethod
    def __call__(self, run: Run) -> None:
        """Compute the part and keep it."""

    @cached_property
    def name(self) -> str:
        """Name of the part."""
        return f"{self.kind}-{digest_of(self.store.fingerprint, _FORMAT, *self._contents())[:24]}"

    @property
    def file(self) -> Path:
        """File of the part."""
        return self.store.path(self.name)

    @property
    def done(self) -> bool:
        """True if the part is there and whole."""
        return self.store.holds(self.name)


class RowsTask(StoredTask):
    """A task that computes rows; what it has is kept every few seconds, so that a long one is not lost as a whole."""

    @property
    @abc.abstractmethod
    def number(self) -> int:
        """Number of rows."""

    @abc.abstractmethod
    def _begin(self) -> tuple[CapsuleRows, list[int]]:
        """Return the rows before anything is computed, and the numbers of those to be filled."""

    @abc.abstractmethod
    def capsule(self, row: int, run: Run) -> tuple[Measurement, Prior]:
        """Return what was measured of the capsule of a row, and its prior."""

    def _fill(self, rows: CapsuleRows, row: int, run: Run) -> None:
        try:
            measurement, prior = self.capsule(row, run)
        except InputError as error:
            rows.refuse(row, Status.UNUSABLE, str(error))
            return
        fill_exactly(rows, row, measurement, run if prior is run.prior else replace(run, prior=prior))

    def __call__(self, run: Run) -> None:
        """Compute the rows, from where an interrupted attempt left off, and keep them."""
        begun = f"{self.name}-begun"
        kept = self.store.load(begun)
        rows, left = self._begin() if kept is None else (CapsuleRows.of_arrays(kept), kept["left"].tolist())
        saved = time.monotonic()
        with threadpool_limits(limits=1):  # the matrices are tiny: threads would wait for each other
            while left:
                self._fill(rows, left.pop(0), run)
                if left and time.monotonic() - saved > _LONGEST_UNKEPT:
                    self.store.save(begun, rows.arrays | {"left": np.array(left)})
                    saved = time.monotonic()
        self.store.save(self.name, rows.arrays)
        self.store.remove(begun)

    @property
    def rows(self) -> CapsuleRows:
        """The rows of a task that is done."""
        arrays = self.store.load(self.name)
        assert arrays is not None, "the workers see the same files"
        return CapsuleRows.of_arrays(arrays)


@dataclass(frozen=True)
class TableTask(RowsTask):
    """Some rows of a table of lengths."""

    measured: MeasuredLengths = field(repr=False)
    kind: ClassVar[str] = "rows"

    @property
    def number(self) -> int:
        return len(self.measured)

    def _contents(self) -> Sequence[Any]:
        measured = self.measured
        return [measured.numbers[name] for name in NUMBERS], measured.names, measured.refusals, measured.priors

    def _begin(self) -> tuple[CapsuleRows, list[int]]:
        measured = self.measured
        rows = CapsuleRows.empty(measured.names.tolist(), [""] * self.number)
        rows.fill(slice(None), measured.numbers)
        for row in np.flatnonzero(measured.refusals != "").tolist():
            why = str(measured.refusals[row])
            status = why.removeprefix("status: ")  # that of the measurement, which a row may bring
            known = status in Status.__members__ and status != why
            rows["status"][row], rows["reason"][row] = (status, "") if known else (Status.UNUSABLE.name, why)
        return rows, np.flatnonzero(measured.refusals == "").tolist()

    def capsule(self, row: int, run: Run) -> tuple[Measurement, Prior]:
        texts, where = self.measured.prior_texts(row), f"{self.measured.source}: capsule {self.measured.names[row]}"
        prior = run.prior.with_texts(texts, where=where) if texts else run.prior
        return self.measured.measurement(row), prior

    @property
    def rows(self) -> CapsuleRows:
        rows = super().rows  # other rows of the table may have changed since
        rows["source"][:], rows["sha256"][:] = self.measured.source, self.measured.sha256
        return rows


@dataclass(frozen=True)
class FileTask(RowsTask):
    """One file of a measurement, or one picture."""

    measured: Path
    name_of_capsule: str
    kind: ClassVar[str] = "file"
    number: ClassVar[int] = 1

    def _contents(self) -> Sequence[Any]:
        files = self.measured, *_named_in(self.measured)
        return [self.name_of_capsule, *((str(file), _content(file)) for file in files)]

    def _begin(self) -> tuple[CapsuleRows, list[int]]:
        return CapsuleRows.empty([self.name_of_capsule], [str(self.measured)]), [0]

    def capsule(self, row: int, run: Run) -> tuple[Measurement, Prior]:
        return measured_file(self.measured, run), prior_of_file(self.measured, run.prior)

    def _fill(self, rows: CapsuleRows, row: int, run: Run) -> None:
        try:
            measurement = measured_file(self.measured, run)
            rows.fill(row, {"sha256": measurement.sha256, **numbers_of(measurement)})
            if measurement.status.ok:
                fill_exactly(rows, row, measurement, replace(run, prior=prior_of_file(self.measured, run.prior)))
            else:
                rows["status"][row] = measurement.status.name
        except CapsbayesError as error:
            rows.refuse(row, Status.UNUSABLE, str(error))


@dataclass(frozen=True)
class OutlinesTask(RowsTask):
    """Some capsules of a file of outlines, and a line for each that cannot be used."""

    measurements: tuple[Measurement, ...] = field(repr=False)
    left_out: tuple[str, ...] = field(default=(), repr=False)
    kind: ClassVar[str] = "outlines"

    @property
    def number(self) -> int:
        return len(self.measurements) + len(self.left_out)

    def _contents(self) -> Sequence[Any]:
        return [(measurement.source, measurement) for measurement in self.measurements], self.left_out

    def _begin(self) -> tuple[CapsuleRows, list[int]]:
        seen, lines = self.measurements, self.left_out
        parts = [measurement.source.rpartition(": ") for measurement in seen]
        names = [*(name for _, _, name in parts), *(line.partition(": expected ")[0] for line in lines)]
        rows = CapsuleRows.empty(names, [*(file for file, _, _ in parts), *[""] * len(lines)])
        for row, measurement in enumerate(seen):
            rows.fill(row, numbers_of(measurement))
        for row, line in enumerate(lines, start=len(seen)):
            rows.refuse(row, Status.UNUSABLE, line)
        return rows, list(range(len(seen)))

    def capsule(self, row: int, run: Run) -> tuple[Measurement, Prior]:
        return self.measurements[row], run.prior


def _named_in(file: Path) -> list[Path]:
    """Return the files that a measurement names, as its experiment and its outline."""
    if file.suffix != ".toml":
        return []
    try:
        content = InputFile.read(file).content
    except InputError:  # reported when the measurement itself is read
        return []
    texts = [value for table in (content, *content.values()) if isinstance(table, Mapping) for value in table.values()]
    named = [file.parent / text for text in texts if isinstance(text, str) and len(text) < _LONGEST_NAME]
    return [path for path in named if path.is_file()]


def _content(file: Path) -> bytes:
    """Return a hash of the content of a file; of one that cannot be read, none: its row says why."""
    try:
        return hashlib.sha256(read_bytes(file)).digest()
    except InputError:
        return b""


def prior_of_file(file: Path, default: Prior) -> Prior:
    """Return the prior that a measurement file states, with the default for what it does not state."""
    if file.suffix.lower() in PICTURES:
        return default
    refuse_membrane(file, "a batch")
    return Prior.read(file, default)


def measured_file(file: Path, run: Run) -> Measurement:
    """Return the measurement of a file: read from it, or measured in a picture."""
    if file.suffix.lower() not in PICTURES:
        return Measurement.read(file)
    from capsbayes.image import measure

    if run.experiment is None or not (run.capsule_velocity or run.flow_rate):
        missing, advice = "experiment", "give it for all pictures"
        if run.experiment is not None:
            missing, advice = "capsule_velocity", "give the flow rate, or a velocity that all share with its spread"
        raise InputError(str(file), missing, "what a picture does not show", "nothing", advice)
    return measure(
        file,
        run.experiment,
        background=run.background,
        flow=run.flow,
        by_hand=run.by_hand,
        capsule_velocity=run.capsule_velocity,
        flow_rate=run.flow_rate,
    )


# The capsules of a run, of a folder, of a table or of a file of outlines, as tasks

ROWS = 250  # of a table in one task: a fraction of a second of work, on the table of the model
_EXACT_ROWS = 8  # of a table or a file of outlines in one task that takes the exact engine: some seconds of work


def listed(source: Path | MeasuredLengths, run: Run, store: Store) -> list[RowsTask]:
    """List the capsules of a run as tasks, in the order of the rows."""
    if isinstance(source, MeasuredLengths):
        known_experiment(source.source, run.experiment)
        return _table(source, run, store)
    check_there(source)
    if source.is_dir():
        files = capsule_files(source)
        if not files:
            expected = f"a folder with measurement files (.toml) or pictures ({', '.join(PICTURES)})"
            raise InputError(str(source), "", expected, "a folder without any")
        return [FileTask(store, file, _name_in(source, file)) for file in files]
    if source.suffix not in (*SHEETS, ".parquet", ".nc"):
        expected = "a folder, a .csv, .xlsx, .parquet or .nc file"
        raise InputError(str(source), "", expected, f"a file that ends in {source.suffix or 'nothing'}")
    known_experiment(source, run.experiment)
    if is_table_of_lengths(source):
        return _table(MeasuredLengths.read(source), run, store)
    measured = read_set(source, run.experiment)
    seen, left_out = measured.measurements, measured.left_out
    tasks = [OutlinesTask(store, seen[first : first + _EXACT_ROWS]) for first in range(0, len(seen), _EXACT_ROWS)]
    return [*tasks, *([OutlinesTask(store, (), left_out)] if left_out else [])]


def capsule_at(row: int, tasks: Sequence[RowsTask], run: Run) -> tuple[Measurement, Prior]:
    """Return what was measured of the capsule of a row of all tasks, and its prior."""
    ends = np.cumsum([task.number for task in tasks])
    number = int(np.searchsorted(ends, row, side="right"))
    return tasks[number].capsule(row - int(ends[number]) + tasks[number].number, run)


def _table(measured: MeasuredLengths, run: Run, store: Store) -> list[RowsTask]:
    """List the rows of a table; a velocity or flow rate that is hardly known is refused."""
    for name in ("capsule_velocity", "flow_rate"):
        value, error = measured.numbers[name], measured.numbers[f"{name}_error"]
        expected = f"a standard error below {LOOSEST_VELOCITY:.0%} of the {name.rpartition('_')[2]}"
        measured = measured.refused(error > LOOSEST_VELOCITY * value, f"{name}_error", expected)
    rows = _EXACT_ROWS if run.model.coordinates or run.prior.is_general else ROWS
    return [TableTask(store, measured.taken(slice(first, first + rows))) for first in range(0, len(measured), rows)]


def _name_in(folder: Path, file: Path) -> str:
    """Return the name of the capsule of a file: FILM/capsule-1 where several films left folders within the folder."""
    if file.name != "measurement.toml":
        return file.stem
    within = file.parent.relative_to(folder).as_posix()
    return folder.resolve().name if within == "." else within


def capsule_files(folder: Path) -> list[Path]:
    """Return measurement files and pictures of a folder, and measurement files further down, as of films."""
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
    """Return cross-section of the channel and view of the outlines, by the first capsule that states them."""
    check_there(source)
    view, refused = MID_PLANE, None
    if source.is_dir():
        files = capsule_files(source)
        for file in files:
            try:
                if file.suffix.lower() in PICTURES:
                    view = SILHOUETTE
                    break
                measurement = Measurement.read(file)
                if experiment is None and measurement.experiment_file:
                    experiment = Experiment.read(measurement.experiment_file)
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


def check_there(source: Path) -> None:
    """Refuse a source that does not exist, and a film or an .rtdc file, which is measured first."""
    if not source.exists():
        raise InputError(str(source), "", "a folder, a table of lengths or a file of outlines", "nothing there")
    if is_recording(source):
        raise unmeasured(source)


# Capsules of a run sampled with emcee: to keep their draws, or to check the rows of some drawn at random

_AGREES = 0.1  # standard deviation


@dataclass(frozen=True)
class Compared:
    """Largest differences between sampled posteriors and rows, over all quantities of the capsules checked."""

    capsules: int
    agreeing: int  # those whose medians and ends agree in every quantity
    median: float  # largest difference of a median and of an end of the intervals, in standard deviations
    ends_68: float
    ends_95: float
    wider: int  # of the others: those of which only ends differ, and lie farther out in the row

    def __str__(self) -> str:
        others = self.capsules - self.agreeing
        wider = (
            f"; of those that do not, {self.wider} of {others} have the wider intervals in their row, as where emcee "
            "misses a distant shape"
        )
        return (
            f"{self.agreeing} of {self.capsules} capsules drawn at random and sampled with emcee agree within "
            f"{_AGREES:g} sd; the medians differ by at most {self.median:.3f} sd, the ends of 68 % intervals by "
            f"{self.ends_68:.3f} sd, those of 95 % intervals by {self.ends_95:.3f} sd{wider if others else ''}"
        )


@dataclass(frozen=True)
class CheckTask(StoredTask):
    """One capsule, to be sampled."""

    measurement: Measurement
    summaries: Floats  # (7, 7), of its row
    seed: int
    prior: Prior
    kind: ClassVar[str] = "check"

    def _contents(self) -> Sequence[Any]:
        return self.seed, self.measurement.source, self.measurement, self.summaries, self.prior

    @property
    def differences(self) -> Floats:
        """Of median, lower and upper ends of the 68 % and of the 95 % interval, in standard deviations : (7, 5) array.

        That of an end is positive where the row has it farther out.
        """
        values = self.store.load(self.name)
        assert values is not None, "the workers see the same files"
        return np.asarray(values["differences"])

    def __call__(self, run: Run) -> None:
        """Sample the capsule and keep the differences."""
        experiment = run.experiment_of(self.measurement)
        with steps_kept(self.store, self.name):
            how: dict[str, Any] = {"engine": "emcee", "seed": self.seed, "prior": self.prior, "error_budget": False}
            sampled = identify(self.measurement, run.model, experiment, **how)
        differences = np.zeros((len(REPORTED), 5))
        for number, name in enumerate(REPORTED):
            other = np.array(list(sampled.marginals[name].as_dict().values()))
            sd = self.summaries[number, 1]
            if sd > 0.0:
                differences[number] = (other - self.summaries[number])[2:] / sd * [1.0, 1.0, -1.0, 1.0, -1.0]
        self.store.save(self.name, {"differences": differences})


def compared(differences: Sequence[Floats]) -> Compared:
    """Summarise the differences of several capsules."""
    away = np.array(differences)  # (n, 7, 5)
    far = np.abs(away) > _AGREES
    agreeing = ~far.any(axis=(1, 2))
    wider = ~agreeing & ~far[:, :, 0].any(axis=1) & ~(far & (away < 0.0)).any(axis=(1, 2))
    median, *ends = np.abs(away).max(axis=(0, 1)).tolist()
    largest = median, max(ends[:2]), max(ends[2:])
    return Compared(len(away), int(np.count_nonzero(agreeing)), *largest, int(np.count_nonzero(wider)))


@dataclass(frozen=True)
class ChainTask:
    """One capsule, whose posterior is sampled with emcee and written."""

    measurement: Measurement
    prior: Prior
    file: Path  # where the posterior goes, as `capsbayes identify` writes it
    digest: str  # hash of what it is computed from

    @classmethod
    def of(cls, row: int, name: str, tasks: Sequence[RowsTask], folder: Path, run: Run) -> ChainTask:
        """Return the task of one row, whose file is named by number and name."""
        measurement, prior = capsule_at(row, tasks, run)
        experiment = run.experiment_of(measurement)
        digest = digest_of(run.fingerprint, measurement.source, measurement, experiment, prior)
        file = folder / f"{row + 1:06d}-{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}.nc"
        return cls(measurement, prior, file, digest)

    @property
    def done(self) -> bool:
        """True if the file is there and was computed from the same; it is written whole or not at all."""
        return work_of(self.file) == self.digest

    def __call__(self, run: Run) -> None:
        """Sample and write."""
        experiment = run.experiment_of(self.measurement)
        with steps_kept(Store(self.file.parent, self.digest), self.file.stem):
            posterior = identify(self.measurement, run.model, experiment, seed=run.seed, prior=self.prior)
        posterior.write(self.file, work=self.digest)


# From many measured capsules to their posteriors: in parallel, resumable, one row a capsule

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
        or a DataFrame with the columns of a table, which the page on many capsules lists.
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
    finish = functools.partial(_finish, run=run, scheduler=scheduler, workers=workers, progress=progress)
    store = Store(parts, run.fingerprint)
    with only_run(out), keeping(parts), refusing(parts, "a folder that can be written"):
        tasks = listed(given, run, store)
        finish(tasks, "parts")
        rows = CapsuleRows.joined((task.rows for task in tasks), sum(task.number for task in tasks))
        attributes = _attributes(run, str(given) if isinstance(given, Path) else given.source)
        population = Population.of(rows, attributes, limit_of(model))
        population.write(out.with_suffix(".csv"))
        checks = _checks(population, tasks, run, store, check, most_checked)
        if checks:
            finish(checks, "capsules sampled")
            agreement = compared([task.differences for task in checks])
            population.dataset.attrs["agreement"] = json.dumps(asdict(agreement))
        population.write(out)
        if chains is not None:
            make_folder(Path(chains))
            usable = np.flatnonzero(np.isfinite(population["surface_shear_modulus_median"])).tolist()
            names = population["name"]
            finish([ChainTask.of(row, str(names[row]), tasks, Path(chains), run) for row in usable], "chains")
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


def _finish(
    tasks: Sequence[StoredTask | ChainTask],
    what: str,
    *,
    run: Run,
    scheduler: str | None,
    workers: int | None,
    progress: bool,
) -> None:
    """Run the tasks that are not done; again those still missing if a worker was killed."""
    names = {task.file.name for task in tasks}

    def count() -> tuple[int, str]:  # by one look into their folder: there may be a hundred thousand files
        folder = tasks[0].file.parent if tasks else None
        present = os.listdir(folder) if folder is not None and folder.exists() else ()
        return len(names.intersection(present)), what

    with progress_bar(len(names), what, show=progress, count=count):
        for attempt in range(_ATTEMPTS):
            missing = [task for task in tasks if not task.done]
            try:
                run_tasks(missing, scheduler, workers, run)
                return
            except BrokenProcessPool:
                left = _ATTEMPTS - attempt - 1
                _logger.warning("A worker was killed; what is finished is kept. Attempts left: %d.", left)
    advice = "give it more memory or fewer workers, and start again: what is finished is kept"
    raise InputError("workers", "", "workers that run to their end", "one killed at each attempt", advice)


def _attributes(run: Run, source: str) -> dict[str, Any]:
    stated: dict[str, Any] = {}
    if (known := run.experiment) is not None:
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


def _checks(
    population: Population, tasks: Sequence[RowsTask], run: Run, store: Store, share: float, most: int
) -> list[CheckTask]:
    """Return the tasks that sample capsules drawn at random, a share of those that can be used, at least one."""
    usable = np.flatnonzero(population.usable)
    number = min(int(np.ceil(share * len(usable))), most, len(usable))
    rows = np.random.default_rng([run.seed, 2]).choice(usable, size=number, replace=False) if number else usable[:0]
    checks = []
    for row in sorted(rows.tolist()):
        measurement, prior = capsule_at(row, tasks, run)
        summaries = np.array([[population[f"{name}_{each}"][row] for each in STATISTICS] for name in REPORTED])
        checks.append(CheckTask(store, measurement, summaries, run.seed, prior))
    return checks
