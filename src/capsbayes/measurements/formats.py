"""The forms of a set on disk: a folder of measurement files, a table of lengths, a file of outlines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.measurement import Measurement
from capsbayes.measurements.folder import read_folder, write_folder
from capsbayes.measurements.measured_set import MeasuredSet
from capsbayes.measurements.netcdf import read_netcdf, write_netcdf
from capsbayes.measurements.table import SHEETS, read_table, write_table

_READERS = dict.fromkeys(SHEETS, read_table) | {".nc": read_netcdf}


def read_set(path: str | Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a folder of measurement files, a table of lengths (.csv, .xlsx) or a file of outlines (.nc).

    Parameters
    ----------
    path : path
    experiment : Experiment or path, optional
        Channel and liquid, if the set does not name its experiment.

    Returns
    -------
    MeasuredSet

    Raises
    ------
    InputError
        If the path is none of these, or no capsule can be used.
    """
    path = Path(path)
    if path.is_dir():
        return read_folder(path, experiment)
    expected = "a folder of measurement files, a .csv or .xlsx table or a .nc file"
    if not path.exists():
        raise InputError(str(path), "", expected, "nothing there")
    if path.suffix not in _READERS:
        advice = "put the measurement files into one folder" if path.suffix == ".toml" else ""
        raise InputError(str(path), "", expected, f"a file that ends in {path.suffix or 'nothing'}", advice)
    return _READERS[path.suffix](path, experiment)


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
