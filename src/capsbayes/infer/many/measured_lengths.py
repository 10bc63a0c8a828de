"""Lengths and velocities of many capsules as arrays, for tables of up to a million rows."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.infer.inputs import LOOSEST_VELOCITY
from capsbayes.measurement import CONDITIONS
from capsbayes.measurements.netcdf import opened
from capsbayes.measurements.table import COLUMNS, NAMES, OPTIONAL, check_columns
from capsbayes.measurements.table import CONDITIONS as CONDITION_COLUMNS

__all__ = ["NUMBERS", "MeasuredLengths", "is_table_of_lengths"]

Floats = NDArray[np.float64]
Strings = NDArray[np.str_]

NUMBERS = (*COLUMNS, *OPTIONAL, *CONDITIONS)
"""Columns of a row: lengths over l, the rest in SI."""

_NEEDED = tuple(COLUMNS)


@dataclass(frozen=True, eq=False)
class MeasuredLengths:
    """Measured numbers of n capsules.

    Parameters
    ----------
    numbers : mapping of (n,) array
        Each of `NUMBERS`, NaN where it was not measured.
    names : (n,) array of str
    refusals : (n,) array of str
        Reason why a row cannot be used, empty if it can.
    source, sha256 : str
        The file and its fingerprint.
    """

    numbers: Mapping[str, Floats]
    names: Strings
    refusals: Strings
    source: str = ""
    sha256: str = ""

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def read(cls, path: str | Path) -> MeasuredLengths:
        """Read a CSV or Parquet table with the headers of `capsbayes.measurements.table`, or NetCDF of these numbers.

        Raises
        ------
        InputError
            On a file that cannot be read, a column that is missing or unknown, or a table without rows.
        """
        path = Path(path)
        frame = _frame(path)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if not len(frame):
            raise InputError(str(path), "", "a table of at least one capsule", "no rows")
        headers = COLUMNS | OPTIONAL | CONDITION_COLUMNS
        numbers, refusals = {}, np.full(len(frame), "", dtype=object)
        for name in NUMBERS:
            header = next((header for header in headers[name] if header in frame), None)
            numbers[name] = np.full(len(frame), np.nan)
            if header is not None:
                numbers[name], wrong = _numbers(frame[header])
                numbers[name] = headers[name][header] * numbers[name]
                refusals[wrong & (refusals == "")] = f"{header}: expected a number"
        if "status" in frame:
            given = frame["status"].fillna("DONE").astype(str).str.strip().to_numpy()
            for status in np.unique(given[given != "DONE"]):
                refusals[given == status] = f"status: {status}"
        names = next((frame[header].astype(str).to_numpy() for header in NAMES if header in frame), None)
        if names is None:
            names = np.arange(1, len(frame) + 1).astype(str)
        return cls(numbers, np.asarray(names, dtype=np.str_), refusals.astype(np.str_), str(path), digest).checked()

    def checked(self) -> MeasuredLengths:
        """Return the same with those rows refused that are no valid measurement."""
        refusals = self.refusals.astype(object)
        numbers = self.numbers

        def refuse(rows: NDArray[np.bool_], why: str) -> None:
            refusals[rows & (refusals == "")] = why

        for name in _NEEDED:
            refuse(~(np.isfinite(numbers[name]) & (numbers[name] > 0.0)), f"{name}: expected a positive number")
        length, error = numbers["axial_length"], numbers["axial_length_error"]
        seen = ~np.isnan(length)
        refuse(seen & ~(np.isfinite(length) & (length > 0.0)), "axial_length: expected a positive number")
        refuse(seen & ~(np.isfinite(error) & (error > 0.0)), "axial_length_error: expected a positive number")
        refuse(seen & (length > numbers["axial_extent"]), "axial_length: expected at most the axial extent")
        refuse(
            np.abs(np.nan_to_num(numbers["length_correlation"])) >= 1.0, "length_correlation: expected between -1 and 1"
        )
        for name in ("flow_rate", *CONDITIONS):
            given = ~np.isnan(numbers[name])
            refuse(given & ~(np.isfinite(numbers[name]) & (numbers[name] > 0.0)), f"{name}: expected a positive number")
        loose = numbers["capsule_velocity_error"] > LOOSEST_VELOCITY * numbers["capsule_velocity"]
        refuse(loose, f"capsule_velocity: expected a standard error below {LOOSEST_VELOCITY:.0%} of it")
        return replace(self, refusals=refusals.astype(np.str_))

    def taken(self, rows: slice | NDArray[np.intp]) -> MeasuredLengths:
        """Return some of the rows."""
        numbers = {name: values[rows] for name, values in self.numbers.items()}
        return replace(self, numbers=numbers, names=self.names[rows], refusals=self.refusals[rows])

    @property
    def lengths(self) -> Floats:
        """L_z, L_a (NaN where missing) and the covariance zz, za, aa : (n, 5) array [l]."""
        numbers = self.numbers
        error_a = np.nan_to_num(numbers["axial_length_error"])
        cross = np.nan_to_num(numbers["length_correlation"]) * numbers["axial_extent_error"] * error_a
        columns = (
            numbers["axial_extent"],
            numbers["axial_length"],
            numbers["axial_extent_error"] ** 2,
            cross,
            error_a**2,
        )
        return np.stack(columns, axis=1)

    @property
    def velocities(self) -> Floats:
        """v_o and its standard error : (n, 2) array [m/s]."""
        return np.stack([self.numbers["capsule_velocity"], self.numbers["capsule_velocity_error"]], axis=1)


def is_table_of_lengths(path: Path) -> bool:
    """Return whether a file is read as arrays: a CSV or Parquet table, or a NetCDF file without outlines."""
    if path.suffix in (".csv", ".parquet"):
        return True
    if path.suffix != ".nc":
        return False
    return "outline" not in opened(path).variables


def _frame(path: Path):  # type: ignore[no-untyped-def]  # a pandas.DataFrame
    import pandas as pd

    if not path.exists():
        raise InputError(str(path), "", "a table of lengths (.csv, .parquet or .nc)", "nothing there")
    if path.suffix == ".nc":
        dataset = opened(path)
        back = {name: next(iter(found)) for name, found in (COLUMNS | OPTIONAL | CONDITION_COLUMNS).items()}
        kept = [name for name in dataset.variables if dataset[name].dims == ("capsule",)]
        frame = pd.DataFrame({back.get(str(name), str(name)): dataset[name].values for name in kept})
    else:
        try:
            frame = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path, skipinitialspace=True)
        except ImportError:
            advice = "pip install 'capsbayes[parquet]', or write the table as .csv"
            raise InputError(str(path), "", "a reader of Parquet files", "none is installed", advice) from None
        except Exception as error:  # each reader has errors of its own for a damaged file
            reason = " ".join(str(error).split())[:120]
            raise InputError(str(path), "", f"a readable {path.suffix} table", reason) from None
    frame.columns = [str(name).strip() for name in frame.columns]
    check_columns(path, list(frame.columns))
    return frame


def _numbers(column) -> tuple[Floats, NDArray[np.bool_]]:  # type: ignore[no-untyped-def]  # a pandas.Series
    """Return the numbers of a column, and where it holds something else."""
    import pandas as pd

    found = pd.to_numeric(column, errors="coerce")
    wrong = found.isna() & ~column.isna() & (column.astype(str).str.strip() != "")
    return found.to_numpy(dtype=np.float64), wrong.to_numpy(dtype=bool)
