"""A set as a table: lengths and velocities, one row a capsule, as a CSV, Parquet or NetCDF file or a pandas DataFrame.

Headers or cells carry their units. Lengths are over l; velocities may be in m/s or mm/s. The ``capsules.csv`` that the
measurement of a film leaves is such a table too.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.csv_file import MISSING, blank_rows, is_summary, plain_cell, read_columns, text_of_table
from capsbayes.files.input_file import parsing, read_bytes
from capsbayes.files.output_file import write_file
from capsbayes.measurement import CONDITIONS, Measurement
from capsbayes.measurements.columns import usual_columns
from capsbayes.measurements.measured_set import MeasuredSet, gathered, known_experiment
from capsbayes.measurements.netcdf import opened
from capsbayes.parameters import PARAMETERS, STATED
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd

Strings = NDArray[np.str_]
Rows = Booleans

# name in a measurement, headers under which it is found, and their factors to SI
_VELOCITY = {"_m_per_s": 1.0, "_mm_per_s": 1e-3}
_HEADERS: dict[str, dict[str, float]] = {
    "axial_extent": {"axial_extent_over_l": 1.0},
    "axial_extent_error": {"axial_extent_error_over_l": 1.0},
    "capsule_velocity": {f"capsule_velocity{unit}": scale for unit, scale in _VELOCITY.items()} | {"velocity_m_s": 1.0},
    "capsule_velocity_error": {f"capsule_velocity_error{unit}": scale for unit, scale in _VELOCITY.items()}
    | {"velocity_error_m_s": 1.0},
    "axial_length": {"axial_length_over_l": 1.0},
    "axial_length_error": {"axial_length_error_over_l": 1.0},
    "length_correlation": {"length_correlation": 1.0},
    "flow_rate": {"flow_rate_m3_per_s": 1.0, "flow_rate_ul_per_min": 1e-9 / 60.0},
    "flow_rate_error": {"flow_rate_error_m3_per_s": 1.0, "flow_rate_error_ul_per_min": 1e-9 / 60.0},
    "half_width": {"half_width_m": 1.0, "half_width_um": 1e-6},
    "viscosity": {"viscosity_pa_s": 1.0, "viscosity_mpa_s": 1e-3},
}
NUMBERS = tuple(_HEADERS)
"""Numbers that a row may hold: lengths over l, the others in SI."""

SHEETS = (".csv", ".xlsx")
"""Endings of the tables that a spreadsheet writes."""

_NEEDED, _VELOCITY_PAIR = NUMBERS[:2], NUMBERS[2:4]
_PRIORS = {name: f"{name}_prior" for name in ("surface_shear_modulus", "capsule_radius")}
_NAMES = ("name", "capsule")
_IGNORED = ("status", "frames", "alike")
_SUMMARY_ROWS = 4  # at the end of a table, of means and the like
_ROUNDED = 5e-4  # of a number in such a row
_STATISTICS: dict[str, Callable[[Floats], Any]] = {
    "mean": partial(np.mean, axis=0),
    "median": partial(np.median, axis=0),
    "sum": partial(np.sum, axis=0),
    "standard deviation": partial(np.std, axis=0, ddof=1),
}


@dataclass(frozen=True, eq=False)
class MeasuredLengths:
    """Measured numbers of n capsules.

    Parameters
    ----------
    numbers : mapping of (n,) array
        Each of `NUMBERS`, NaN where it was not measured.
    names : (n,) array of str
    refusals : (n,) array of str
        Why a row cannot be used, empty if it can; ``"status: NAME"`` for the status of a failed measurement.
    source, sha256 : str
        The file and its fingerprint.
    priors : mapping of (n,) array of str
        Of G_s and a, in text form, where capsules have their own; empty where not.
    """

    numbers: Mapping[str, Floats]
    names: Strings
    refusals: Strings
    source: str = ""
    sha256: str = ""
    priors: Mapping[str, Strings] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def read(cls, path: str | Path) -> MeasuredLengths:
        """Read a CSV, .xlsx or Parquet table, or a NetCDF file without outlines.

        Parameters
        ----------
        path : path
            Table with the columns ``axial_extent_over_l``, ``axial_extent_error_over_l``, ``capsule_velocity_m_per_s``
            and ``capsule_velocity_error_m_per_s`` (or both ``..._mm_per_s``), next to which or in place of which
            ``flow_rate_ul_per_min`` (or ``_m3_per_s``) and ``flow_rate_error_ul_per_min`` may stand; optionally
            ``axial_length_over_l`` and
            ``axial_length_error_over_l``, whose cells may be empty where the rear is hidden, ``length_correlation``,
            ``half_width_um`` (or ``_m``) and ``viscosity_pa_s`` (or
            ``_mpa_s``) where they are not those of the experiment, ``name``, and ``status``, which is DONE for a
            capsule to be used. ``surface_shear_modulus_prior`` and ``capsule_radius_prior`` hold texts as
            ``"50 +/- 10 mN/m"`` that replace the prior of the run. A number may also be headed by its name with a unit,
            ``capsule_velocity [mm/s]``, or by its name alone, ``capsule_velocity``, over cells in SI or with units of
            their own, see `capsbayes.measurements.columns.usual_columns`.

        Raises
        ------
        InputError
            On a file that cannot be read, a column that is missing or unknown, or a table without rows.
        """
        path = Path(path)
        frame = _frame(path)
        return cls.of_frame(frame, source=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())

    @classmethod
    def of_frame(cls, frame: pd.DataFrame, *, source: str = "table", sha256: str = "") -> MeasuredLengths:
        """Take the numbers from a pandas DataFrame with the columns of `read`.

        Cells may be quantities of pint, or texts with units and errors.

        Raises
        ------
        InputError
            On a column that is missing or unknown, or a table without rows.
        """
        import pandas as pd

        if not isinstance(frame, pd.DataFrame):
            raise InputError(source, "", "a path or a DataFrame", f"one of the type {type(frame).__name__}")
        frame = frame.rename(columns=lambda name: str(name).strip()).reset_index(drop=True)
        blank = blank_rows(frame)
        below = (np.cumsum(blank) > 0)[~blank]
        frame = frame[~blank].reset_index(drop=True)
        frame = usual_columns(frame, {name: next(iter(headers)) for name, headers in _HEADERS.items()}, source)
        _check_columns(source, list(frame.columns))
        if not len(frame):
            raise InputError(source, "", "at least one capsule", "none")
        if not sha256:
            sha256 = hashlib.sha256(pd.util.hash_pandas_object(frame).to_numpy().tobytes()).hexdigest()
        numbers, refusals = {}, np.full(len(frame), "", dtype=object)
        for name, headers in _HEADERS.items():
            header = next((header for header in headers if header in frame), None)
            numbers[name] = np.full(len(frame), np.nan)
            if header is None:
                continue
            found = pd.to_numeric(frame[header], errors="coerce")
            numbers[name] = headers[header] * found.to_numpy(dtype=np.float64)
            for row in np.flatnonzero(found.isna() & ~frame[header].isna()).tolist():
                text = str(frame[header][row]).strip()
                if text.lower() not in MISSING:
                    refusals[row] = refusals[row] or f"{header}: expected a number, got {text!r}"
        if "status" in frame:
            given = frame["status"].fillna("DONE").astype(str).str.strip().to_numpy()
            refusals[given != "DONE"] = [f"status: {status}" for status in given[given != "DONE"]]
        label = next((header for header in _NAMES if header in frame), None)
        labels = [""] * len(frame) if label is None else list(map(_label, frame[label]))
        for row, name in enumerate(labels):
            if is_summary(name) or (below[row] and not name):
                got = f"{name!r}, a row of a spreadsheet's summary" if name else "one without a name below a blank row"
                refusals[row] = f"name: expected a capsule, got {got}"
        names = np.array([name or str(row) for row, name in enumerate(labels, start=1)], dtype=object)
        texts = {name: frame[header].fillna("").astype(str) for name, header in _PRIORS.items() if header in frame}
        priors = {name: values.str.strip().to_numpy(dtype=np.str_) for name, values in texts.items()}
        read = cls(numbers, names.astype(np.str_), refusals.astype(np.str_), source, sha256, priors)
        return read._checked()._without_summary()

    def _without_summary(self) -> MeasuredLengths:
        """Refuse those of the last rows in which all numbers are the mean, the sum or the spread of the rows above."""
        values, refusals = np.stack(list(self.numbers.values()), axis=1), self.refusals.astype(object)
        rounded = np.array([0.1 if name.endswith("_error") else _ROUNDED for name in self.numbers])
        last = range(max(len(self) - _SUMMARY_ROWS, 0), len(self))
        above = values[: last.start][self.refusals[: last.start] == ""]
        for row in last:
            varying = np.isfinite(values[row]) & (np.ptp(above, axis=0) > 0.0 if len(above) else False)
            if refusals[row] == "" and len(above) > 2 and varying.sum() > 1:
                for word, found in _STATISTICS.items():
                    if np.all((np.abs(values[row] - found(above)) <= rounded * np.abs(found(above)))[varying]):
                        refusals[row] = f"name: expected a capsule, got the {word} of the rows above"
            if refusals[row] == "":
                above = np.concatenate([above, values[row : row + 1]])
        return replace(self, refusals=refusals.astype(np.str_))

    def _checked(self) -> MeasuredLengths:
        """Refuse the rows that no single measurement may hold."""
        numbers, checked = self.numbers, self
        length = numbers["axial_length"]
        velocity = np.isnan(numbers["flow_rate"]) | ~np.isnan([numbers[name] for name in _VELOCITY_PAIR]).all(axis=0)
        for name in NUMBERS:
            if name == "length_correlation":
                continue
            given = ~np.isnan(length if name == "axial_length_error" else numbers[name]) | (name in _NEEDED)
            given = velocity if name in _VELOCITY_PAIR else given
            least = -np.finfo(float).tiny if name == "flow_rate_error" else 0.0  # a flow rate may be known
            wrong = given & ~(np.isfinite(numbers[name]) & (numbers[name] > least))
            checked = checked.refused(wrong, name, "a positive finite number")
            if name in STATED:
                (_, least, most), unit = STATED[name], PARAMETERS[name].unit
                beyond = given & ((numbers[name] < least) | (numbers[name] > most))
                checked = checked.refused(beyond, name, f"a value from {least:g} to {most:g} {unit}")
        checked = checked.refused(length > numbers["axial_extent"], "axial_length", "at most the axial extent")
        for name in ("axial_extent", "axial_length", "capsule_velocity", "flow_rate"):
            error = f"{name}_error"
            checked = checked.refused(numbers[error] > numbers[name], error, "an error of at most the value")
        wrong = np.abs(np.nan_to_num(numbers["length_correlation"])) >= 1.0
        return checked.refused(wrong, "length_correlation", "a number between -1 and 1")

    def refused(self, rows: Rows, name: str, expected: str) -> MeasuredLengths:
        """Return the same with further rows refused.

        Parameters
        ----------
        rows : (n,) bool array
        name : str
            The number at fault.
        expected : str
            The right form of the number.
        """
        rows = rows & (self.refusals == "")
        if not rows.any():
            return self
        refusals = self.refusals.astype(object)
        refusals[rows] = [f"{name}: expected {expected}, got {value:g}" for value in self.numbers[name][rows]]
        return replace(self, refusals=refusals.astype(np.str_))

    def taken(self, rows: slice | NDArray[np.intp]) -> MeasuredLengths:
        """Return some of the rows."""
        numbers = {name: values[rows] for name, values in self.numbers.items()}
        priors = {name: texts[rows] for name, texts in self.priors.items()}
        return replace(self, numbers=numbers, names=self.names[rows], refusals=self.refusals[rows], priors=priors)

    def prior_texts(self, row: int) -> dict[str, str]:
        """Return the priors of G_s and a that a row states, by name."""
        return {name: str(texts[row]) for name, texts in self.priors.items() if texts[row]}

    def measurement(self, row: int) -> Measurement:
        """Return one row as a measurement.

        Raises
        ------
        InputError
            If it is refused.
        """
        where = f"{self.source}: capsule {self.names[row]}"
        if why := str(self.refusals[row]):
            key, _, words = why.partition(": ")
            expected, _, got = words.removeprefix("expected ").partition(", got ")
            if key == "status":
                expected, got = "DONE", str(Status.__members__.get(words, repr(words)))
            raise InputError(where, key, expected, got)
        numbers = {name: float(values[row]) for name, values in self.numbers.items() if np.isfinite(values[row])}
        own = {name: numbers.pop(name) for name in CONDITIONS if name in numbers}
        if "axial_length" not in numbers:
            numbers.pop("axial_length_error", None)
        return Measurement(**numbers, conditions=own, source=where)  # type: ignore[arg-type]

    @property
    def lengths(self) -> Floats:
        """L_z, L_a (NaN where missing) and the covariance zz, za, aa : (n, 5) array [l]."""
        extent, error_z = self.numbers["axial_extent"], self.numbers["axial_extent_error"]
        error_a = np.nan_to_num(self.numbers["axial_length_error"])
        cross = np.nan_to_num(self.numbers["length_correlation"]) * error_z * error_a
        return np.stack((extent, self.numbers["axial_length"], error_z**2, cross, error_a**2), axis=1)

    @property
    def rates(self) -> Floats:
        """Flow rate (NaN where it is unknown) and its standard error : (n, 2) array [m^3/s]."""
        return np.stack([self.numbers["flow_rate"], np.nan_to_num(self.numbers["flow_rate_error"])], axis=1)

    @property
    def velocities(self) -> Floats:
        """v_o and its standard error : (n, 2) array [m/s]."""
        return np.stack([self.numbers["capsule_velocity"], self.numbers["capsule_velocity_error"]], axis=1)


def read_table(path: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a table of lengths.

    Parameters
    ----------
    path : Path
        As `MeasuredLengths.read` reads it.
    experiment : Experiment or path

    Raises
    ------
    InputError
        On a column that is missing or unknown, or if no capsule can be used.
    """
    known = known_experiment(path, experiment)
    lengths = MeasuredLengths.read(path)
    measurements, left_out = gathered([partial(lengths.measurement, row) for row in range(len(lengths))], path)
    return MeasuredSet(measurements, known, left_out)


def write_table(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write a table that `read_table` reads.

    Raises
    ------
    InputError
        If a capsule has an outline, for which a table has no place.
    """
    import pandas as pd

    if any(measurement.outline is not None for measurement in measurements):
        raise InputError(str(path), "outline", "capsules without outlines", "one with", "write a folder or a .nc")
    columns: dict[str, list[float | None]] = {}
    for name, headers in _HEADERS.items():
        values = [
            measurement.conditions.get(name) if name in CONDITIONS else getattr(measurement, name)
            for measurement in measurements
        ]
        if any(value is not None for value in values):
            columns[next(iter(headers))] = values
    frame = pd.DataFrame(columns, index=pd.RangeIndex(1, len(measurements) + 1, name="name"), dtype=np.float64)
    write_file(path, text_of_table(frame))


def is_table_of_lengths(path: Path) -> bool:
    """Return True for a CSV, .xlsx or Parquet table, and for a NetCDF file without outlines."""
    return path.suffix in (*SHEETS, ".parquet") or (path.suffix == ".nc" and "outline" not in opened(path).variables)


def _frame(path: Path) -> pd.DataFrame:
    import pandas as pd

    if path.suffix in SHEETS:
        return read_columns(path, "table of lengths", texts=(*_NAMES, "status", *_PRIORS.values()))
    raw = read_bytes(path, "table of lengths")
    if path.suffix == ".nc":
        dataset = opened(path)
        kept = [str(name) for name in dataset.variables if dataset[name].dims == ("capsule",)]
        return pd.DataFrame({next(iter(_HEADERS.get(name, {name: 1.0}))): dataset[name].values for name in kept})
    with parsing(str(path), "a readable .parquet table"):
        try:
            return pd.read_parquet(io.BytesIO(raw))
        except ImportError:
            advice = "pip install 'capsbayes[parquet]', or write the table as .csv"
            raise InputError(str(path), "", "a reader of Parquet files", "none is installed", advice) from None


def _label(name: object) -> str:
    """Return the name of a capsule, empty where a cell states none."""
    if name is None or name != name:
        return ""
    whole = isinstance(name, float) and name.is_integer()
    return plain_cell(str(int(name) if whole else name)).strip()  # type: ignore[call-overload]


def _check_columns(source: str, columns: list[str]) -> None:
    """Refuse a table with an unknown column, or without one that is needed."""
    known = [header for headers in _HEADERS.values() for header in headers] + [*_PRIORS.values(), *_NAMES, *_IGNORED]
    for column in columns:
        if column not in known:
            raise InputError(
                source,
                column,
                f"one of the columns {', '.join(known)}",
                f"{'an unknown' if column else 'a nameless'} column",
            )
    by_rate = any(header in columns for header in _HEADERS["flow_rate"])
    for name in _NEEDED if by_rate else (*_NEEDED, *_VELOCITY_PAIR):
        if not any(header in columns for header in _HEADERS[name]):
            advice = "or flow_rate_ul_per_min" if name in _VELOCITY_PAIR else ""
            header, got = next(iter(_HEADERS[name])), f"only {', '.join(columns)}"
            raise InputError(source, header, "a column of this name", got, advice)
