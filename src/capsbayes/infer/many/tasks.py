"""Independent tasks of a run, as some rows of a table or one file; the rows of each are one part of a store.

The part is named by a hash of the run and of the content of what was measured, so that it is found again after an
interruption, and nothing is taken from other settings or from a file that has changed since.
"""

from __future__ import annotations

import abc
import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Floats
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.files.input_file import PICTURES, InputFile, read_bytes
from capsbayes.infer.many.capsule_rows import CapsuleRows
from capsbayes.infer.many.exact_row import fill_exactly, numbers_of
from capsbayes.infer.many.run import Run
from capsbayes.infer.membrane import refuse_membrane
from capsbayes.infer.prior import Prior
from capsbayes.measurement import Measurement
from capsbayes.measurements.table import NUMBERS, MeasuredLengths
from capsbayes.status import Status
from capsbayes.work import Store, digest_of

_LONGEST_NAME = 250
_LONGEST_UNKEPT = 5.0  # s of work


@dataclass(frozen=True)
class StoredTask(abc.ABC):
    """A task whose result is a part of a store.

    Parameters
    ----------
    store : Store
    """

    store: Store
    kind: ClassVar[str]
    """First word of the name of the part."""

    @abc.abstractmethod
    def _contents(self) -> Sequence[Any]:
        """Return what the part is computed from, the settings of the store excepted."""

    @abc.abstractmethod
    def __call__(self, run: Run) -> None:
        """Compute the part and keep it."""

    @cached_property
    def name(self) -> str:
        """Name of the part."""
        return f"{self.kind}-{digest_of(self.store.fingerprint, *self._contents())[:24]}"

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
    def begin(self, run: Run) -> tuple[CapsuleRows, list[int]]:
        """Compute what takes little time; return the rows, and the numbers of those that remain to be filled."""

    @abc.abstractmethod
    def fill(self, rows: CapsuleRows, row: int, run: Run) -> None:
        """Compute one of the rows that remain."""

    def compute(self, run: Run) -> CapsuleRows:
        """Compute the rows, from where an interrupted attempt left off."""
        begun = f"{self.name}-begun"
        kept = self.store.load(begun)
        rows, left = self.begin(run) if kept is None else (CapsuleRows.of_arrays(kept), kept["left"].tolist())
        saved = time.monotonic()
        with threadpool_limits(limits=1):  # the matrices are tiny: threads would wait for each other
            while left:
                self.fill(rows, left.pop(0), run)
                if left and time.monotonic() - saved > _LONGEST_UNKEPT:
                    self.store.save(begun, rows.arrays | {"left": np.array(left)})
                    saved = time.monotonic()
        return rows

    @property
    def rows(self) -> CapsuleRows | None:
        """The rows, None if they are missing or damaged."""
        arrays = self.store.load(self.name)
        return None if arrays is None else CapsuleRows.of_arrays(arrays)

    def __call__(self, run: Run) -> None:
        """Compute the rows and keep them."""
        self.store.save(self.name, self.compute(run).arrays)
        self.store.remove(f"{self.name}-begun")


@dataclass(frozen=True)
class TableTask(RowsTask):
    """Some rows of a table of lengths.

    Parameters
    ----------
    store : Store
    measured : MeasuredLengths
    """

    measured: MeasuredLengths = field(repr=False)
    kind: ClassVar[str] = "rows"

    @property
    def number(self) -> int:
        """Number of rows."""
        return len(self.measured)

    def _contents(self) -> Sequence[Any]:
        measured = self.measured
        return [measured.numbers[name] for name in NUMBERS], measured.names, measured.refusals, measured.priors

    def begin(self, run: Run) -> tuple[CapsuleRows, list[int]]:
        """Return rows with what was measured, and with status and reason of those that cannot be used."""
        del run
        measured, blank = self.measured, np.full(self.number, "", dtype=object)
        numbers = np.stack([measured.numbers[name] for name in NUMBERS], axis=1)
        rows = CapsuleRows.empty(measured.names.astype(object), blank, blank.copy(), numbers)
        for row in np.flatnonzero(measured.refusals != "").tolist():
            why = str(measured.refusals[row])
            status = why.removeprefix("status: ")  # that of the measurement, which a row may bring
            known = status in Status.__members__ and status != why
            rows.status[row], rows.reason[row] = (status, "") if known else (Status.UNUSABLE.name, why)
        return rows, np.flatnonzero(measured.refusals == "").tolist()

    def fill(self, rows: CapsuleRows, row: int, run: Run) -> None:
        """Compute a row, with the prior that it states."""
        texts, where = self.measured.prior_texts(row), f"{self.measured.source}: capsule {self.measured.names[row]}"
        try:
            own = replace(run, prior=run.prior.with_texts(texts, where=where)) if texts else run
            measurement = self.measured.measurement(row)
        except InputError as error:
            rows.refuse(row, Status.UNUSABLE, str(error))
            return
        fill_exactly(rows, row, measurement, own)

    @property
    def rows(self) -> CapsuleRows | None:
        """The rows, with the fingerprint of the whole table as it is now, other rows of which may have changed."""
        rows = super().rows
        if rows is not None:
            rows.source[:], rows.sha256[:] = self.measured.source, self.measured.sha256
        return rows


@dataclass(frozen=True)
class FileTask(RowsTask):
    """One file of a measurement, or one picture.

    Parameters
    ----------
    store : Store
    measured : Path
    capsule : str
        Its name in tables.
    """

    measured: Path
    capsule: str
    kind: ClassVar[str] = "file"
    number: ClassVar[int] = 1

    def _contents(self) -> Sequence[Any]:
        """Return the name of the capsule, and the content of the file and of those that it names."""
        return [self.capsule, *((str(file), _content(file)) for file in (self.measured, *_named_in(self.measured)))]

    def begin(self, run: Run) -> tuple[CapsuleRows, list[int]]:
        """Return an empty row."""
        del run
        return CapsuleRows.empty(_texts([self.capsule]), _texts([str(self.measured)]), _texts([""]), _no_numbers(1)), [
            0
        ]

    def fill(self, rows: CapsuleRows, row: int, run: Run) -> None:
        """Measure the capsule if need be, and compute its row."""
        try:
            measurement = measured_file(self.measured, run)
            rows.sha256[row], rows.numbers[row] = measurement.sha256, numbers_of(measurement)
            if measurement.status.ok:
                fill_exactly(rows, row, measurement, replace(run, prior=prior_of_file(self.measured, run.prior)))
            else:
                rows.status[row] = measurement.status.name
        except CapsbayesError as error:
            rows.refuse(row, Status.UNUSABLE, str(error))


@dataclass(frozen=True)
class OutlinesTask(RowsTask):
    """Some capsules of a file of outlines.

    Parameters
    ----------
    store : Store
    measurements : tuple of Measurement
    left_out : tuple of str
        One line for each capsule of the file that cannot be used.
    """

    measurements: tuple[Measurement, ...] = field(repr=False)
    left_out: tuple[str, ...] = field(default=(), repr=False)
    kind: ClassVar[str] = "outlines"

    @property
    def number(self) -> int:
        """Number of rows."""
        return len(self.measurements) + len(self.left_out)

    def _contents(self) -> Sequence[Any]:
        return [(measurement.source, measurement) for measurement in self.measurements], self.left_out

    def begin(self, run: Run) -> tuple[CapsuleRows, list[int]]:
        """Return rows with what was measured, and with the reasons of those that cannot be used."""
        del run
        names = [measurement.source.rpartition(": ")[2] for measurement in self.measurements]
        names += [line.partition(": expected ")[0] for line in self.left_out]
        sources = [measurement.source.rpartition(": ")[0] for measurement in self.measurements] + [""] * len(
            self.left_out
        )
        blank = [""] * len(names)
        rows = CapsuleRows.empty(_texts(names), _texts(sources), _texts(blank), _no_numbers(len(names)))
        for row, measurement in enumerate(self.measurements):
            rows.numbers[row] = numbers_of(measurement)
        for row, line in enumerate(self.left_out, start=len(self.measurements)):
            rows.refuse(row, Status.UNUSABLE, line)
        return rows, list(range(len(self.measurements)))

    def fill(self, rows: CapsuleRows, row: int, run: Run) -> None:
        """Compute a row on a grid for its outline."""
        fill_exactly(rows, row, self.measurements[row], run)


def _texts(texts: list[str]) -> NDArray[Any]:
    return np.array(texts, dtype=object)


def _no_numbers(count: int) -> Floats:
    return np.full((count, len(NUMBERS)), np.nan)


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
    """Return the measurement of a file: read from it, or measured in a picture.

    Raises
    ------
    InputError
        If it cannot be read, or a picture lacks what it does not show.
    """
    if file.suffix.lower() not in PICTURES:
        return Measurement.read(file)
    from capsbayes.image import measure  # OpenCV takes its time

    if run.experiment is None or not (run.capsule_velocity or run.flow_rate):
        missing, advice = "experiment", "give it for all pictures"
        if run.experiment is not None:
            missing, advice = "capsule_velocity", "give the flow rate, or a velocity that all share with its spread"
        raise InputError(str(file), missing, "what a picture does not show", "nothing", advice)
    how: dict[str, Any] = {"background": run.background, "flow": run.flow, "by_hand": run.by_hand}
    how |= {"capsule_velocity": run.capsule_velocity, "flow_rate": run.flow_rate}
    return measure(file, run.experiment, **how)
