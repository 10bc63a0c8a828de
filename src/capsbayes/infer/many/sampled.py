"""Capsules of a run sampled with emcee: to keep their draws, or to check the rows of some drawn at random."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats
from capsbayes.infer import identify
from capsbayes.infer.many.run import Run
from capsbayes.infer.many.tasks import StoredTask
from capsbayes.infer.posterior import REPORTED
from capsbayes.infer.posterior_file import work_of
from capsbayes.infer.prior import Prior
from capsbayes.measurement import Measurement
from capsbayes.work import Store, digest_of, steps_kept

_AGREES = 0.1  # standard deviation


@dataclass(frozen=True)
class Compared:
    """Largest differences between sampled posteriors and rows, over all quantities of the capsules checked.

    Parameters
    ----------
    capsules : int
        Number of capsules checked.
    agreeing : int
        Number of capsules whose medians and ends of intervals agree within 0.1 standard deviation, in every quantity.
    median, ends_68, ends_95 : float
        Largest difference of a median and of an end of the intervals, in standard deviations.
    wider : int
        Number of the other capsules of which only ends differ, and lie farther out in the row.
    """

    capsules: int
    agreeing: int
    median: float
    ends_68: float
    ends_95: float
    wider: int

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

    def as_dict(self) -> dict[str, float]:
        """Return the fields by name."""
        return asdict(self)


@dataclass(frozen=True)
class CheckTask(StoredTask):
    """One capsule, to be sampled.

    Parameters
    ----------
    store : Store
    measurement : Measurement
    summaries : (7, 7) array
        Of its row.
    seed : int
    prior : Prior
    """

    measurement: Measurement
    summaries: Floats
    seed: int
    prior: Prior
    kind: ClassVar[str] = "check"

    def _contents(self) -> Sequence[Any]:
        return self.seed, self.measurement.source, self.measurement, self.summaries, self.prior

    @property
    def differences(self) -> Floats | None:
        """Of median, lower and upper ends of the 68 % and of the 95 % interval : (7, 5) array, None if not done.

        In standard deviations; that of an end is positive where the row has it farther out.
        """
        values = self.store.load(self.name)
        return None if values is None else values["differences"]

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


def drawn_rows(usable: Booleans, share: float, most: int, seed: int) -> NDArray[np.intp]:
    """Draw the rows to check at random: a share of those that can be checked, at least one."""
    rows = np.flatnonzero(usable)
    number = min(int(np.ceil(share * len(rows))), most, len(rows))
    return np.sort(np.random.default_rng([seed, 2]).choice(rows, size=number, replace=False))


@dataclass(frozen=True)
class ChainTask:
    """One capsule, whose posterior is sampled with emcee and written.

    Parameters
    ----------
    measurement : Measurement
    prior : Prior
    file : Path
        Where the posterior goes, as `capsbayes identify` writes it.
    digest : str
        Hash of what it is computed from.
    """

    measurement: Measurement
    prior: Prior
    file: Path
    digest: str

    @classmethod
    def of(cls, measurement: Measurement, prior: Prior, folder: Path, row: int, name: str, run: Run) -> ChainTask:
        """Return the task of one row, whose file is named by number and name."""
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
