"""A set as a table: a CSV file of lengths, one row a capsule.

Headers carry their units. Lengths are over l; velocities may be in m/s or mm/s. The ``capsules.csv`` that the
measurement of a film leaves is such a table too.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.measurement import Measurement
from capsbayes.measurements.measured_set import MeasuredSet, gathered, known_experiment
from capsbayes.status import Status

__all__ = ["COLUMNS", "CONDITIONS", "NAMES", "OPTIONAL", "check_columns", "read_table", "write_table"]

Row = Mapping[str, str]

# name in a measurement, headers under which it is found, and their factors to SI
_VELOCITY = {"_m_per_s": 1.0, "_mm_per_s": 1e-3}
COLUMNS: dict[str, dict[str, float]] = {
    "axial_extent": {"axial_extent_over_l": 1.0},
    "axial_extent_error": {"axial_extent_error_over_l": 1.0},
    "capsule_velocity": {f"capsule_velocity{unit}": scale for unit, scale in _VELOCITY.items()} | {"velocity_m_s": 1.0},
    "capsule_velocity_error": {f"capsule_velocity_error{unit}": scale for unit, scale in _VELOCITY.items()}
    | {"velocity_error_m_s": 1.0},
}
OPTIONAL: dict[str, dict[str, float]] = {
    "axial_length": {"axial_length_over_l": 1.0},
    "axial_length_error": {"axial_length_error_over_l": 1.0},
    "length_correlation": {"length_correlation": 1.0},
    "flow_rate": {"flow_rate_m3_per_s": 1.0, "flow_rate_ul_per_min": 1e-9 / 60.0},
}
CONDITIONS: dict[str, dict[str, float]] = {
    "half_width": {"half_width_m": 1.0, "half_width_um": 1e-6},
    "viscosity": {"viscosity_pa_s": 1.0, "viscosity_mpa_s": 1e-3},
}
NAMES = ("name", "capsule")
_PASSED_OVER = ("status", "frames")


def read_table(path: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a table of lengths.

    Parameters
    ----------
    path : Path
        CSV file with the columns ``axial_extent_over_l``, ``axial_extent_error_over_l``, ``capsule_velocity_m_per_s``
        and ``capsule_velocity_error_m_per_s`` (or both ``..._mm_per_s``); optionally ``axial_length_over_l`` and
        ``axial_length_error_over_l``, whose cells may be empty where the rear is hidden, ``length_correlation``,
        ``flow_rate_ul_per_min`` (or ``_m3_per_s``), ``half_width_um`` (or ``_m``) and ``viscosity_pa_s`` (or
        ``_mpa_s``) where they are not those of the experiment, ``name``, and ``status``, which is
        DONE for a capsule to be used.
    experiment : Experiment or path

    Raises
    ------
    InputError
        On a column that is missing or unknown, or if no capsule can be used.
    """
    known = known_experiment(path, experiment)
    columns, rows = _rows(path)
    check_columns(path, columns)
    readers = [partial(_measurement, path, number, row) for number, row in enumerate(rows, start=1)]
    measurements, left_out = gathered(readers, path)
    return MeasuredSet(measurements, known, left_out)


def write_table(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write a table that `read_table` reads.

    Raises
    ------
    InputError
        If a capsule has an outline, for which a table has no place.
    """
    for one in measurements:
        if one.outline is not None:
            raise InputError(str(path), "outline", "capsules without outlines", "one with", "write a folder or a .nc")
    seen = {name for name in COLUMNS | OPTIONAL if any(getattr(one, name) is not None for one in measurements)}
    headers = {name: next(iter(found)) for name, found in (COLUMNS | OPTIONAL).items() if name in seen}
    stated = {name for one in measurements for name in one.conditions}
    own = {name: next(iter(found)) for name, found in CONDITIONS.items() if name in stated}
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["name", *headers.values(), *own.values()])
        for number, one in enumerate(measurements, start=1):
            numbers = [*(getattr(one, name) for name in headers), *(one.conditions.get(name) for name in own)]
            table.writerow([number, *("" if value is None else repr(float(value)) for value in numbers)])


def _rows(path: Path) -> tuple[list[str], list[Row]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets begin with a mark
            table = csv.DictReader(file, skipinitialspace=True)
            table.fieldnames = [name.strip() for name in table.fieldnames or []]
            return list(table.fieldnames), list(table)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), "", "a readable CSV file", str(error)) from None


def check_columns(path: Path, columns: list[str]) -> None:
    """Refuse a table with an unknown column, or without one that is needed.

    Raises
    ------
    InputError
    """
    headers = {name: tuple(found) for name, found in (COLUMNS | OPTIONAL | CONDITIONS).items()}
    known = [header for found in headers.values() for header in found] + [*NAMES, *_PASSED_OVER]
    for column in columns:
        if column not in known:
            raise InputError(str(path), column, f"one of the columns {', '.join(known)}", "an unknown column")
    for name in COLUMNS:
        if not any(header in columns for header in headers[name]):
            raise InputError(str(path), headers[name][0], "a column of this name", f"only {', '.join(columns)}")


def _measurement(path: Path, number: int, row: Row) -> Measurement:
    """One row; what is wrong in it is said with its name."""
    label = next((row[name] for name in NAMES if row.get(name)), str(number))
    where = f"{path}: capsule {label}"
    status = (row.get("status") or "DONE").strip()
    if status != "DONE":
        said = Status.__members__.get(status)
        raise InputError(where, "status", "DONE", str(said) if said else repr(status))
    numbers = {name: _number(row, where, found) for name, found in COLUMNS.items()}
    numbers |= {name: _number(row, where, found, optional=True) for name, found in OPTIONAL.items()}
    correlation = numbers.pop("length_correlation") or 0.0
    conditions = {name: _number(row, where, found, optional=True) for name, found in CONDITIONS.items()}
    own = {name: value for name, value in conditions.items() if value is not None}
    return Measurement(**numbers, length_correlation=correlation, conditions=own, source=where)  # type: ignore[arg-type]


def _number(row: Row, where: str, headers: Mapping[str, float], *, optional: bool = False) -> float | None:
    header = next((one for one in headers if one in row), "")
    text = (row.get(header) or "").strip()
    if optional and text.lower() in ("", "nan"):
        return None
    try:
        return headers[header] * float(text)
    except ValueError:
        raise InputError(where, header, "a number", repr(text)) from None
