"""Independent tasks of a run, as some rows of a table or one file; the rows of each are one part of a store.

The part is named by a hash of the run and of what was measured, so that it is found again after an interruption, and
nothing is taken from other settings or from a file that has changed since.
"""

from __future__ import annotations

import abc
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.infer.many.capsule_rows import CapsuleRows
from capsbayes.infer.many.exact_row import fill_exactly, numbers_of
from capsbayes.infer.many.run import Run
from capsbayes.infer.many.table_rows import rows_of_table
from capsbayes.input_file import PICTURES, InputFile
from capsbayes.measurement import Measurement
from capsbayes.measurements.table import NUMBERS, MeasuredLengths
from capsbayes.status import Status
from capsbayes.work import Store

_LONGEST_NAME = 250


@dataclass(frozen=True)
class StoredTask(abc.ABC):
    """A task whose result is a part of a store.

    Parameters
    ----------
    store : Store
    """

    store: Store

    @abc.abstractmethod
    def _name(self) -> str:
        """Return the name of the part."""

    @abc.abstractmethod
    def __call__(self, run: Run) -> None:
        """Compute the part and keep it."""

    @cached_property
    def name(self) -> str:
        """Name of the part."""
        return self._name()

    @property
    def file(self) -> Path:
        """File of the part."""
        return self.store.path(self.name)

    @property
    def done(self) -> bool:
        """True if the part is there and whole."""
        return self.store.load(self.name) is not None


class RowsTask(StoredTask):
    """A task that computes rows."""

    @property
    @abc.abstractmethod
    def number(self) -> int:
        """Number of rows."""

    @abc.abstractmethod
    def compute(self, run: Run) -> CapsuleRows:
        """Compute the rows."""

    @property
    def rows(self) -> CapsuleRows | None:
        """The rows, None if they are missing or damaged."""
        arrays = self.store.load(self.name)
        return None if arrays is None else CapsuleRows(**arrays)

    def __call__(self, run: Run) -> None:
        """Compute the rows and keep them."""
        self.store.save(self.name, self.compute(run).arrays)


def hash_of(store: Store, *contents: str | bytes) -> str:
    """Return a hash of what a part is computed from and of the settings of its store."""
    digest = hashlib.sha256(store.fingerprint.encode())
    for content in contents:
        digest.update(b"\0" + (content.encode() if isinstance(content, str) else content))
    return digest.hexdigest()[:24]


@dataclass(frozen=True)
class TableTask(RowsTask):
    """Some rows of a table of lengths.

    Parameters
    ----------
    store : Store
    measured : MeasuredLengths
    """

    measured: MeasuredLengths = field(repr=False)

    @property
    def number(self) -> int:
        """Number of rows."""
        return len(self.measured)

    def _name(self) -> str:
        numbers = (np.ascontiguousarray(self.measured.numbers[name]).tobytes() for name in NUMBERS)
        return f"rows-{hash_of(self.store, *numbers, *self.measured.names, *self.measured.refusals)}"

    def compute(self, run: Run) -> CapsuleRows:
        """Compute the rows from the table of the model."""
        assert run.experiment is not None
        return rows_of_table(self.measured, run, run.experiment)


@dataclass(frozen=True)
class FileTask(RowsTask):
    """One file of a measurement, or one picture.

    Parameters
    ----------
    store : Store
    measured : Path
    """

    measured: Path
    number: ClassVar[int] = 1

    def _name(self) -> str:
        """Return a name that changes when the file, or one that it names, changes."""
        stamps = [file.stat() for file in (self.measured, *_named_in(self.measured))]
        states = [f"{stamp.st_size} {stamp.st_mtime_ns}" for stamp in stamps]
        return f"file-{hash_of(self.store, str(self.measured.resolve()), *states)}"

    def compute(self, run: Run) -> CapsuleRows:
        """Measure the capsule if need be, and compute its row."""
        name = self.measured.parent.name if self.measured.name == "measurement.toml" else self.measured.stem
        rows = CapsuleRows.empty(_texts([name]), _texts([str(self.measured)]), _texts([""]), _no_numbers(1))
        try:
            measurement = measured_file(self.measured, run)
            rows.sha256[0], rows.numbers[0] = measurement.sha256, numbers_of(measurement)
            if measurement.status.ok:
                fill_exactly(rows, 0, measurement, run)
            else:
                rows.status[0] = measurement.status.name
        except CapsbayesError as error:
            rows.status[0], rows.reason[0] = Status.UNUSABLE.name, str(error)
        return rows


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

    @property
    def number(self) -> int:
        """Number of rows."""
        return len(self.measurements) + len(self.left_out)

    def _name(self) -> str:
        contents: list[str | bytes] = []
        for measurement in self.measurements:
            contents += [measurement.source, numbers_of(measurement).tobytes()]
            if measurement.outline is not None:
                outline = measurement.outline
                contents += [np.ascontiguousarray(outline.points).tobytes(), repr(outline.noise)]
        return f"outlines-{hash_of(self.store, *contents, *self.left_out)}"

    def compute(self, run: Run) -> CapsuleRows:
        """Compute the rows on a grid for each outline."""
        assert run.experiment is not None
        names = [measurement.source.rpartition(": ")[2] for measurement in self.measurements]
        names += [line.partition(": expected ")[0] for line in self.left_out]
        sources = [measurement.source.rpartition(": ")[0] for measurement in self.measurements] + [""] * len(
            self.left_out
        )
        blank = [""] * len(names)
        rows = CapsuleRows.empty(_texts(names), _texts(sources), _texts(blank), _no_numbers(len(names)))
        for row, measurement in enumerate(self.measurements):
            rows.numbers[row] = numbers_of(measurement)
            fill_exactly(rows, row, measurement, run)
        for row, line in enumerate(self.left_out, start=len(self.measurements)):
            rows.status[row], rows.reason[row] = Status.UNUSABLE.name, line
        return rows


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

    if run.experiment is None or run.capsule_velocity is None:
        missing = "experiment" if run.experiment is None else "capsule_velocity"
        raise InputError(str(file), missing, "what a picture does not show", "nothing", "give it for all pictures")
    how = {"background": run.background, "flow": run.flow}
    return measure(file, run.experiment, capsule_velocity=run.capsule_velocity, **how)  # type: ignore[arg-type]
