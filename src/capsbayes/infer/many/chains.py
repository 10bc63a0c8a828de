"""The draws of each capsule, for those who ask for them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from capsbayes.infer import identify
from capsbayes.infer.many.run import Run
from capsbayes.measurement import Measurement

__all__ = ["ChainTask"]


@dataclass(frozen=True)
class ChainTask:
    """One capsule, whose posterior is sampled with emcee and written.

    Parameters
    ----------
    measurement : Measurement
    file : Path
        Where the posterior goes, as `capsbayes identify` writes it.
    """

    measurement: Measurement
    file: Path

    @classmethod
    def of(cls, measurement: Measurement, folder: Path, row: int, name: str) -> ChainTask:
        """Return the task of one row, whose file is named by number and name."""
        return cls(measurement, folder / f"{row + 1:06d}-{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}.nc")

    @property
    def done(self) -> bool:
        """Whether it is there: it is written whole or not at all."""
        return self.file.exists()

    def __call__(self, run: Run) -> None:
        """Sample and write."""
        experiment = run.experiment_of(self.measurement)
        identify(self.measurement, run.model, experiment, seed=run.seed, prior=run.prior).write(self.file)
