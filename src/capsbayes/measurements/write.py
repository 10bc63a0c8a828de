"""Writing a set in one of its forms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from capsbayes.experiment import Experiment
from capsbayes.measurement import Measurement
from capsbayes.measurements.folder import write_folder
from capsbayes.measurements.netcdf import write_netcdf
from capsbayes.measurements.table import write_table

__all__ = ["write_set"]


def write_set(path: str | Path, measurements: Sequence[Measurement], experiment: Experiment) -> None:
    """Write a set in the form that the ending of its name says.

    Parameters
    ----------
    path : path
        Ends in ``.csv`` for a table of lengths, in ``.nc`` for a file of outlines, and is a folder otherwise. Only the
        folder holds the experiment too.
    measurements : sequence of Measurement
    experiment : Experiment

    Raises
    ------
    InputError
        If the form has no place for what the capsules have.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_table(path, measurements)
    elif path.suffix == ".nc":
        write_netcdf(path, measurements)
    else:
        write_folder(path, measurements, experiment)
