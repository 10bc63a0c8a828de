"""The draws of each capsule, for those who ask for them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from capsbayes.infer import identify
from capsbayes.infer.many.run import run_of
from capsbayes.measurement import Measurement

__all__ = ["ChainTask"]


@dataclass(frozen=True)
class ChainTask:
    """One capsule, whose posterior is sampled with emcee and written.

    Parameters
    ----------
    run : Path
        As `Run.kept_in` says it.
    measurement : Measurement
    kept : Path
        Where the posterior goes, as `capsbayes identify` writes it.
    """

    run: Path
    measurement: Measurement
    kept: Path

    @classmethod
    def of(cls, run: Path, measurement: Measurement, folder: Path, row: int, name: str) -> ChainTask:
        """The task of one row: its file is named by number and name."""
        return cls(run, measurement, folder / f"{row + 1:06d}-{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}.nc")

    @property
    def done(self) -> bool:
        """Whether it is there: it is written whole or not at all."""
        return self.kept.exists()

    def __call__(self) -> None:
        """Sample and write."""
        run = run_of(self.run)
        experiment = run.experiment_of(self.measurement)
        identify(self.measurement, run.model, experiment, seed=run.seed, prior=run.prior).write(self.kept)
