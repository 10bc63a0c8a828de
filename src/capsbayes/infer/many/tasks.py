"""Pieces of a run that are computed apart: some rows of a table, or one file. Each keeps its rows in a file of its own.

The file is named by the fingerprints of the run and of what was measured, so that what is finished is found again after
an interruption, and nothing is taken over from other settings or from a file that has changed since.
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

from capsbayes.errors import CapsbayesError, InputError
from capsbayes.infer.many.capsule_rows import CapsuleRows
from capsbayes.infer.many.exact_row import fill_exactly, numbers_of
from capsbayes.infer.many.measured_lengths import NUMBERS, MeasuredLengths
from capsbayes.infer.many.run import Run, run_of
from capsbayes.infer.many.table_rows import rows_of_table
from capsbayes.input_file import InputFile
from capsbayes.measurement import Measurement
from capsbayes.status import Status

__all__ = ["PICTURES", "FileTask", "OutlinesTask", "TableTask", "Task", "measured_file"]

Floats = NDArray[np.float64]

_LONGEST_NAME = 250
PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")


class Kept(abc.ABC):
    """Work whose rows are kept in a file."""

    @property
    @abc.abstractmethod
    def kept(self) -> Path:
        """The file."""

    @property
    def done(self) -> bool:
        """Whether they are there and whole."""
        return self.rows is not None

    @property
    def rows(self) -> CapsuleRows | None:
        """The rows, None if they are not there or damaged."""
        return CapsuleRows.read(self.kept)


@dataclass(frozen=True)
class TableTask(Kept):
    """Some rows of a table of lengths.

    Parameters
    ----------
    run : Path
        As `Run.kept_in` says it.
    measured : MeasuredLengths
    """

    run: Path
    measured: MeasuredLengths = field(repr=False)

    @property
    def number(self) -> int:
        """Rows."""
        return len(self.measured)

    @cached_property
    def kept(self) -> Path:
        """Where the rows are kept."""
        digest = hashlib.sha256(self.run.name.encode())
        for name in NUMBERS:
            digest.update(np.ascontiguousarray(self.measured.numbers[name]).tobytes())
        digest.update("\0".join([*self.measured.names, *self.measured.refusals]).encode())
        return self.run.with_name(f"rows-{digest.hexdigest()[:24]}.npz")

    def __call__(self) -> None:
        """Compute the rows and keep them."""
        run = run_of(self.run)
        assert run.experiment is not None
        rows_of_table(self.measured, run, run.experiment).write(self.kept)


@dataclass(frozen=True)
class FileTask(Kept):
    """One file of a measurement, or one picture.

    Parameters
    ----------
    run : Path
    file : Path
    """

    run: Path
    file: Path
    number: ClassVar[int] = 1

    @cached_property
    def kept(self) -> Path:
        """Where the row is kept; a file that changed since, or one that it names, has another."""
        digest = hashlib.sha256(f"{self.run.name}\0{self.file.resolve()}".encode())
        for file in (self.file, *_named_in(self.file)):
            stamp = file.stat()
            digest.update(f"\0{stamp.st_size}\0{stamp.st_mtime_ns}".encode())
        return self.run.with_name(f"file-{digest.hexdigest()[:24]}.npz")

    def __call__(self) -> None:
        """Compute the row and keep it."""
        run = run_of(self.run)
        name = self.file.parent.name if self.file.name == "measurement.toml" else self.file.stem
        rows = CapsuleRows.empty(_texts([name]), _texts([str(self.file)]), _texts([""]), _no_numbers(1))
        try:
            measurement = measured_file(self.file, run)
            rows.sha256[0], rows.numbers[0] = measurement.sha256, numbers_of(measurement)
            if measurement.status.ok:
                fill_exactly(rows, 0, measurement, run)
            else:
                rows.status[0] = measurement.status.name
        except CapsbayesError as error:
            rows.status[0], rows.reason[0] = Status.UNUSABLE.name, str(error)
        rows.write(self.kept)


@dataclass(frozen=True)
class OutlinesTask(Kept):
    """Some capsules of a file of outlines.

    Parameters
    ----------
    run : Path
    measurements : tuple of Measurement
    left_out : tuple of str
        One line for each capsule of the file that cannot be used.
    """

    run: Path
    measurements: tuple[Measurement, ...] = field(repr=False)
    left_out: tuple[str, ...] = field(default=(), repr=False)

    @property
    def number(self) -> int:
        """Rows."""
        return len(self.measurements) + len(self.left_out)

    @cached_property
    def kept(self) -> Path:
        """Where the rows are kept."""
        digest = hashlib.sha256(self.run.name.encode())
        for one in self.measurements:
            digest.update(one.source.encode() + numbers_of(one).tobytes())
            if one.outline is not None:
                digest.update(np.ascontiguousarray(one.outline.points).tobytes() + repr(one.outline.noise).encode())
        digest.update("\0".join(self.left_out).encode())
        return self.run.with_name(f"outlines-{digest.hexdigest()[:24]}.npz")

    def __call__(self) -> None:
        """Compute the rows and keep them."""
        run = run_of(self.run)
        assert run.experiment is not None
        names = [one.source.rpartition(": ")[2] for one in self.measurements]
        names += [line.partition(": expected ")[0] for line in self.left_out]
        sources = [one.source.rpartition(": ")[0] for one in self.measurements] + [""] * len(self.left_out)
        blank = [""] * len(names)
        rows = CapsuleRows.empty(_texts(names), _texts(sources), _texts(blank), _no_numbers(len(names)))
        for row, one in enumerate(self.measurements):
            rows.numbers[row] = numbers_of(one)
            fill_exactly(rows, row, one, run)
        for row, line in enumerate(self.left_out, start=len(self.measurements)):
            rows.status[row], rows.reason[row] = Status.UNUSABLE.name, line
        rows.write(self.kept)


Task = TableTask | FileTask | OutlinesTask


def _texts(texts: list[str]) -> NDArray[Any]:
    return np.array(texts, dtype=object)


def _no_numbers(count: int) -> Floats:
    return np.full((count, len(NUMBERS)), np.nan)


def _named_in(file: Path) -> list[Path]:
    """Files that a measurement names, as its experiment and its outline."""
    if file.suffix != ".toml":
        return []
    try:
        content = InputFile.read(file).content
    except InputError:  # said when it is read in earnest
        return []
    texts = [value for table in (content, *content.values()) if isinstance(table, Mapping) for value in table.values()]
    named = [file.parent / text for text in texts if isinstance(text, str) and len(text) < _LONGEST_NAME]
    return [one for one in named if one.is_file()]


def measured_file(file: Path, run: Run) -> Measurement:
    """Measurement of a file: read from it, or measured in a picture.

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
