"""Results of capsules, one row each, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.infer.many.mixture import COMPONENTS
from capsbayes.infer.many.mixture import NUMBERS as OF_COMPONENTS
from capsbayes.infer.misfit import PREDICTED
from capsbayes.infer.posterior import REPORTED
from capsbayes.status import Status

Strings = NDArray[Any]  # of str, or of objects that are

LEANINGS = ("border", "prior", "two_shapes", "wrinkles", "unsure_shapes")
"""Borders next to which a posterior may lie: of the model, of the prior ranges, of regions with a caveat."""


@dataclass(frozen=True, eq=False)
class CapsuleRows:
    """Results of n capsules.

    Parameters
    ----------
    name, source, sha256 : (n,) arrays of str
        Name of the capsule, the file it was read from, and the hash of the file.
    status, reason, engine : (n,) arrays of str
        Name of a `Status`; the reason, where the status alone does not tell it; ``grid``.
    numbers : (n, k) array
        Measured numbers, the `NUMBERS` of `capsbayes.measurements.table`.
    summaries : (n, 7, 7) array
        Mean, standard deviation, median and ends of the 68 % and 95 % intervals of the `REPORTED`, SI.
    distance : (n,) array
        Of the lengths from those of the likeliest shape, in standard errors.
    leaning : (n, 5) array
        Shares of the posterior, of `LEANINGS`.
    p_values : (n, 3) array
        Of `capsbayes.infer.misfit.PREDICTED`, NaN where one was not measured.
    reynolds_number : (n,) array
    components : (n, c, 6) array
        Likelihood of (log(G_s / mu), log(a / l)) as a mixture of Gaussians.
    """

    name: Strings
    source: Strings
    sha256: Strings
    status: Strings
    reason: Strings
    engine: Strings
    numbers: Floats
    summaries: Floats
    distance: Floats
    leaning: Floats
    p_values: Floats
    reynolds_number: Floats
    components: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.name)

    @classmethod
    def empty(cls, name: Strings, source: Strings, sha256: Strings, numbers: Floats) -> CapsuleRows:
        """Return rows without results, to be filled."""
        count = len(name)
        blank = np.full(count, "", dtype=object)
        return cls(
            name,
            source,
            sha256,
            blank,
            blank.copy(),
            blank.copy(),
            numbers,
            np.full((count, len(REPORTED), 7), np.nan),
            np.full(count, np.nan),
            np.full((count, len(LEANINGS)), np.nan),
            np.full((count, len(PREDICTED)), np.nan),
            np.full(count, np.nan),
            np.zeros((count, COMPONENTS, len(OF_COMPONENTS)), np.float32),
        )

    def refuse(self, row: int, status: Status, reason: str) -> None:
        """Set status and reason of a row, and clear what an engine may have found for it under another prior."""
        self.status[row], self.reason[row], self.components[row] = status.name, reason, 0.0
        for of_engine in (self.summaries, self.leaning, self.p_values, self.reynolds_number):
            of_engine[row] = np.nan

    @classmethod
    def joined(cls, parts: Iterable[CapsuleRows], count: int) -> CapsuleRows:
        """Join the rows of several, one after the other, so that memory holds them once.

        Parameters
        ----------
        parts : iterable of CapsuleRows
        count : int
            Rows of all together.
        """
        whole: dict[str, NDArray[Any]] = {}
        known: dict[str, str] = {}  # a million rows of one table name the same file
        first = 0
        for part in parts:
            rows = slice(first, first + len(part))
            for field in fields(cls):
                values = getattr(part, field.name)
                if values.dtype.kind in "OU":
                    values = np.array([known.setdefault(text, text) for text in values.tolist()], dtype=object)
                if field.name not in whole:
                    whole[field.name] = np.empty((count, *values.shape[1:]), values.dtype)
                whole[field.name][rows] = values
            first += len(part)
        return cls(**whole)

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> CapsuleRows:
        """Return the rows whose `arrays` these are."""
        known = {field.name: arrays[field.name] for field in fields(cls)}
        texts = {name: values.astype(object) for name, values in known.items() if values.dtype.kind == "U"}
        return cls(**known | texts)

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by name, text as numpy text."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        return arrays | {name: values.astype(np.str_) for name, values in arrays.items() if values.dtype.kind in "OU"}
