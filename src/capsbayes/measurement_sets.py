"""Sets of measurements on disk: folders, tables and NetCDF files."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.csv_file import MISSING, blank_rows, is_summary, plain_cell, read_columns, text_of_table
from capsbayes.files.input_file import VIDEOS, InputFile, check_file, parsing, read_bytes
from capsbayes.files.output_file import write_dataset, write_file
from capsbayes.files.recording import is_film
from capsbayes.measurement import CONDITIONS, MID_PLANE, MeasuredOutline, Measurement, OutlineNoise, Pose, check_view
from capsbayes.parameters import PARAMETERS, STATED
from capsbayes.quantity import Quantity, mistake_in, parsed
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


# Content of a set on disk: the capsules that can be compared, and why the others are omitted


@dataclass(frozen=True, eq=False)
class MeasuredSet:
    """Capsules of one session, as a file or a folder holds them."""

    measurements: tuple[Measurement, ...]
    experiment: Experiment
    left_out: tuple[str, ...] = ()  # a line for each capsule that cannot be used


def check_comparable(measurement: Measurement, where: str) -> None:
    """Refuse a measurement that failed, or that is not over l, or whose outline is not along the flow."""
    if not measurement.status.ok:
        raise InputError(where, "status", "a measurement that is done", str(measurement.status), "leave it out")
    if not measurement.over_half_width:
        raise InputError(where, "axial_extent", "lengths over l", "lengths in metres", "divide by l")
    measurement.check_outline(where)


def gathered(
    readers: Iterable[Callable[[], Measurement]], where: Path
) -> tuple[tuple[Measurement, ...], tuple[str, ...]]:
    """Return the capsules of a set that can be read and compared, and one line for each of the others."""
    comparable: list[Measurement] = []
    left_out: list[str] = []
    for read in readers:
        try:
            measurement = read()
            check_comparable(measurement, measurement.source)
            comparable.append(measurement)
        except InputError as error:
            left_out.append(str(error))
    if not comparable:
        reason = f"{len(left_out)} that cannot be used, the first because of {left_out[0]}" if left_out else "none"
        raise InputError(str(where), "", "at least one capsule", reason)
    return tuple(comparable), tuple(left_out)


def known_experiment(path: str | Path, experiment: Experiment | str | Path | None) -> Experiment:
    """Return the experiment that is given, read if it is a file; refuse none."""
    if experiment is None:
        advice = "say which with experiment=..., or --experiment"
        raise InputError(str(path), "experiment", "the experiment of the capsules", "nothing", advice)
    return experiment if isinstance(experiment, Experiment) else Experiment.read(experiment)


# Columns of a table with units: in the heading, or in each cell, as a text or as a quantity of pint

_EXTENT = ("axial_extent", "axial_extent_error")
_VELOCITY = ("capsule_velocity", "capsule_velocity_error")
_LENGTH = ("axial_length", "axial_length_error")
_RATE = ("flow_rate", "flow_rate_error")
NUMBERS = (*_EXTENT, *_VELOCITY, *_LENGTH, "length_correlation", *_RATE, *CONDITIONS)
"""Numbers that are measured of a capsule, or that are its own conditions: lengths over l, the others in SI."""

_ERROR = "_error"
_UNITS = {name: PARAMETERS[name.removesuffix(_ERROR)].unit for name in NUMBERS if name != "length_correlation"}
_ENDINGS: dict[str, dict[str, float]] = {  # of headings of numbers of a unit, with what they are over it
    "l": {"_over_l": 1.0},
    "m/s": {"_m_per_s": 1.0, "_mm_per_s": 1e-3},
    "m^3/s": {"_m3_per_s": 1.0, "_ul_per_min": 1e-9 / 60.0},
    "m": {"_m": 1.0, "_um": 1e-6},
    "Pa s": {"_pa_s": 1.0, "_mpa_s": 1e-3},
    "": {"": 1.0},
}
_HEADERS = {
    name: {f"{name}{ending}": factor for ending, factor in _ENDINGS[_UNITS.get(name, "")].items()} for name in NUMBERS
}
_HEADERS["capsule_velocity"] |= {"velocity_m_s": 1.0}  # of older tables
_HEADERS["capsule_velocity_error"] |= {"velocity_error_m_s": 1.0}
_USUAL = {name: next(iter(headers)) for name, headers in _HEADERS.items()}
_SYMBOLS = {
    f"{PARAMETERS[both[0]].symbol}{end}": name
    for both in (_EXTENT, _LENGTH, _VELOCITY, _RATE)
    for name, end in zip(both, ("", _ERROR), strict=True)
}
_WITH_UNIT = re.compile(r"(?P<name>\w+)\s*[\[(](?P<unit>[^\])]*)[\])]")
_STATES_ERROR = re.compile(r"±|\+\s?/?\s?-")


def _usual_columns(frame: pd.DataFrame, source: str) -> pd.DataFrame:
    """Return a table whose columns have the usual headings, which are those of SI, for one with units of its own."""
    # ``capsule_velocity [mm/s]`` is a column of numbers, or of texts as ``"4.86 +/- 0.04"``, in this unit;
    # ``capsule_velocity`` one of numbers in SI (of lengths, over l), of quantities of pint, or of texts as
    # ``"4.86 +/- 0.04 mm/s"``. The errors of texts make a column of their own. ``v_o [mm/s]``
    # is the first by its symbol.
    columns: dict[str, Any] = {}
    for heading, values in frame.items():
        with_unit = _WITH_UNIT.fullmatch(str(heading))
        written = with_unit["name"] if with_unit else str(heading)
        name = _SYMBOLS.get(written, written)
        if name != written and not with_unit and _target(name) and values.dtype.kind in "fiu":
            shown = PARAMETERS[name.removesuffix(_ERROR)].shown_unit
            raise InputError(source, written, f"a unit, as {written} [{shown}]", "none")
        if name not in _USUAL or (name == _USUAL[name] and not with_unit):
            usual = {str(heading): values}
        else:
            scale = _factor(name, with_unit["unit"], source, str(heading)) if with_unit else (1.0, "")
            usual = _of_cells(name, values, *scale)
        for key, column in usual.items():
            if key in columns:
                raise InputError(source, str(heading), "one statement of each number", f"a second one of {key}")
            columns[key] = column
    return type(frame)(columns)


def _target(name: str) -> str:
    """Return the SI unit of a number, empty for a ratio and for a length over l."""
    return PARAMETERS[name.removesuffix(_ERROR)].si if name in _UNITS else ""


def _factor(name: str, unit: str, source: str, heading: str) -> tuple[float, str]:
    """Return what a number in a unit is in SI, and the unit."""
    target = _target(name)
    wanted = f"a unit of {name.removesuffix(_ERROR).replace('_', ' ')}" + (
        f", as {target}" if target else f": none, as it is {'over l' if 'axial' in name else 'a ratio'}"
    )
    if not unit.strip() or unit.strip() in ("l", "-"):
        if target:
            raise InputError(source, heading, wanted, repr(unit))
        return 1.0, ""
    one = parsed(f"1 {unit}", (target,), where=source, key=heading, wanted=wanted)
    if one.second or one.is_range:
        raise InputError(source, heading, wanted, repr(unit))
    return one.first, unit


def _of_cells(name: str, values: pd.Series, factor: float, unit: str) -> dict[str, Any]:
    """Return the column of a number, and that of its errors if its cells state any."""
    import pandas as pd

    if pd.api.types.is_numeric_dtype(values.dtype) and values.dtype.kind in "fiu":
        return {_USUAL[name]: factor * values}
    cells = [_cell(value, name, factor, unit) for value in values]
    of_error = _USUAL.get(f"{name}{_ERROR}")
    if of_error is None:  # as of a viscosity, whose error is that of the experiment
        cells = [(str(value), np.nan) if cell[1] > 0.0 else cell for value, cell in zip(values, cells, strict=True)]
    numbers, errors = [cell[0] for cell in cells], np.array([cell[1] for cell in cells])
    columns = {_USUAL[name]: pd.Series(numbers, index=values.index, dtype=object)}
    stated = any(isinstance(number, str) and _STATES_ERROR.search(number) for number in numbers)
    if of_error is not None and (stated or np.any(errors > 0.0)):
        columns[of_error] = pd.Series(errors, index=values.index)
    return columns


def _cell(value: Any, name: str, factor: float, unit: str) -> tuple[Any, float]:
    """Return value and error in SI of a cell, by its column's unit; one that cannot be read as it is, to be refused."""
    text = isinstance(value, str)
    if value is None or (isinstance(value, float) and np.isnan(value)) or (text and not value.strip()):
        return np.nan, np.nan
    with_unit = f"{value} {unit}" if text and unit else value
    try:
        read = Quantity.of(with_unit, units=(_target(name),), where="table", key=name, signed=True)
    except InputError:
        return str(value), np.nan
    if read.shape != "normal":
        return str(value), np.nan
    scale = 1.0 if text else factor
    return scale * read.value, scale * read.error if read.error else np.nan


# A set as one NetCDF file: outlines of all capsules with their lengths, velocities and noise

_NOISE = {"noise_scale": "l", "noise_correlation": "l", "noise_white": "1"}
_OUTLINE = ("capsule", "point", "axis")


def read_netcdf(path: Path, experiment: Experiment | str | Path | None) -> MeasuredSet:
    """Read a file of outlines."""
    # Outlines (capsule, point, axis) [l], columns (z, y), are filled up with NaN; the numbers of `_UNITS` and `_NOISE`
    # are over the capsules. Conditions are NaN where they are those of the experiment, which the file may name.
    dataset = opened(path)
    named = dataset.attrs.get("experiment")
    known = known_experiment(path, path.parent / str(named) if experiment is None and named else experiment)
    _check(path, dataset)
    readers = [partial(_measurement, path, dataset, row) for row in range(dataset.sizes["capsule"])]
    measurements, left_out = gathered(readers, path)
    return MeasuredSet(measurements, known, left_out)


def write_netcdf(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write a file that `read_netcdf` reads; refuse capsules without outlines, and outlines that differ in kind."""
    outlines = [seen.outline for seen in measurements if seen.outline is not None]
    if len(outlines) < len(measurements):
        raise InputError(str(path), "outline", "capsules with outlines", "one without", "write a folder or a .csv")
    if any(outline.pose != Pose() for outline in outlines):
        advice = "write a folder"
        raise InputError(str(path), "outline.pose", "outlines of the usual pose", "one of another", advice)
    views = sorted({outline.view for outline in outlines})
    if len(views) > 1:
        raise InputError(str(path), "outline.view", "outlines of one view", ", ".join(views), "write a folder")
    points = np.full((len(outlines), max(len(outline.points) for outline in outlines), 2), np.nan)
    for row, outline in enumerate(outlines):
        points[row, : len(outline.points)] = outline.points
    noises = [(outline.noise.scale, outline.noise.correlation_length, outline.noise.white) for outline in outlines]
    numbers = {name: [getattr(seen, name) for seen in measurements] for name in (*_EXTENT, *_VELOCITY, *_LENGTH)}
    numbers |= dict(zip(_NOISE, np.array(noises).T, strict=True))
    own = {name: [seen.conditions.get(name, np.nan) for seen in measurements] for name in CONDITIONS}
    own |= {name: [getattr(seen, name) or np.nan for seen in measurements] for name in _RATE}
    numbers |= {name: values for name, values in own.items() if np.isfinite(values).any()}
    units = _UNITS | _NOISE
    variables = {name: ("capsule", np.array(values, float), {"units": units[name]}) for name, values in numbers.items()}
    dataset = xr.Dataset({**variables, "outline": (_OUTLINE, points, {"units": "l"})}, coords={"axis": ["z", "y"]})
    dataset.attrs["view"] = (views or [MID_PLANE])[0]
    write_dataset(path, dataset)


def opened(path: Path) -> xr.Dataset:
    """Return the content of a NetCDF file of a user."""
    check_file(path, "NetCDF file")
    with parsing(str(path), "a NetCDF file"), xr.open_dataset(path, engine="h5netcdf") as opened:
        return opened.load()


def _check(path: Path, dataset: xr.Dataset) -> None:
    """Refuse a file that lacks a variable, or has one of another shape or unit."""
    velocity = () if "flow_rate" in dataset.variables else _VELOCITY
    needed = ("outline", *_EXTENT, *velocity, "noise_scale", "noise_correlation")
    for name, unit in {"outline": "l", **_UNITS, **_NOISE}.items():
        dims = _OUTLINE if name == "outline" else ("capsule",)
        wanted = f"a variable ({', '.join(dims)}) in {unit}"
        if name not in dataset.variables:
            if name in needed:
                raise InputError(str(path), name, wanted, "nothing", "add the missing variable")
            continue
        variable = dataset[name]
        if variable.dims != dims or variable.dtype.kind not in "fiu" or (name == "outline" and variable.shape[2] != 2):
            sizes = ", ".join(f"{dim}: {size}" for dim, size in variable.sizes.items())
            raise InputError(str(path), name, wanted, f"one of {variable.dtype} ({sizes})")
        if str(variable.attrs.get("units", unit)) != unit:
            raise InputError(str(path), name, wanted, f"one in {variable.attrs['units']}", "convert it")


def _measurement(path: Path, dataset: xr.Dataset, row: int) -> Measurement:
    capsule = dataset.isel(capsule=row)
    label = str(capsule["name"].item()) if "name" in capsule.variables else str(row + 1)
    where = f"{path}: capsule {label}"
    numbers = {name: float(capsule[name]) for name in (*_UNITS, *_NOISE) if name in capsule.variables}
    needed = _EXTENT if np.isfinite(numbers.get("flow_rate", np.nan)) else (*_EXTENT, *_VELOCITY)
    seen = {name: value for name, value in numbers.items() if name in needed or np.isfinite(value)}
    points = np.asarray(capsule["outline"].values, np.float64)
    view = check_view(capsule.attrs.get("view", MID_PLANE), str(path), "view")
    try:
        noise = OutlineNoise(numbers["noise_scale"], numbers["noise_correlation"], numbers.get("noise_white", 0.0))
        outline = MeasuredOutline(points[np.isfinite(points).any(axis=1)], noise, view=view)
    except InputError as error:  # which does not know whose outline it is
        raise InputError(where, error.key, error.expected, error.got, error.advice) from None
    return _measurement_of({name: value for name, value in seen.items() if name not in _NOISE}, where, outline)


def _measurement_of(numbers: Mapping[str, float], where: str, outline: MeasuredOutline | None = None) -> Measurement:
    """Return the measurement that has these of the `NUMBERS`."""
    measured = {name: value for name, value in numbers.items() if name not in CONDITIONS}
    conditions = {name: value for name, value in numbers.items() if name in CONDITIONS}
    return Measurement(**measured, outline=outline, conditions=conditions, source=where)  # type: ignore[arg-type]


# A set as a folder: one measurement file for each capsule, and the file of the experiment

_EXPERIMENT = "experiment.toml"
_MEASURED = ("capsules.csv", "events.csv")  # that measuring a film or an .rtdc file leaves


def read_folder(folder: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read the measurement files of a folder, by default each under the experiment that it names."""
    readers = [partial(Measurement.read, file) for file in measurement_files(folder)]
    measurements, left_out = gathered(readers, folder)
    if experiment is None:
        measurements, known = _each_under_its_own(measurements)
    else:
        known = known_experiment(folder, experiment)
    return MeasuredSet(measurements, known, left_out)


def write_folder(folder: Path, measurements: Sequence[Measurement], experiment: Experiment) -> None:
    """Write ``experiment.toml`` and ``capsule-001.toml`` and so on into a folder without TOML files."""
    if any(measurement.conditions for measurement in measurements):
        raise InputError(str(folder), "conditions", "capsules under one experiment", "others", "write a .csv or a .nc")
    if folder.exists() and (not folder.is_dir() or any(folder.glob("*.toml"))):
        got = "one with TOML files" if folder.is_dir() else "a file"
        raise InputError(str(folder), "", "a folder without TOML files", got, "choose another")
    experiment.write(folder / _EXPERIMENT)
    digits = max(3, len(str(len(measurements))))
    for number, measurement in enumerate(measurements, start=1):
        named = replace(measurement, experiment_file=folder / _EXPERIMENT)
        named.write(folder / f"capsule-{number:0{digits}d}.toml")


def measurement_files(folder: Path) -> list[Path]:
    """Return the measurement files of a folder, and each ``measurement.toml`` of a folder anywhere within it."""
    # A film or an .rtdc file leaves a folder for each capsule, several of them a folder of such folders. One that lies
    # there without a folder of its name with what was measured in it is refused.
    for file in sorted(folder.iterdir()):
        if is_recording(file) and not _is_measured(file):
            raise unmeasured(file)
    files = [*sorted(folder.glob("*.toml")), *sorted(folder.glob("*/**/measurement.toml"))]
    return [file for file in files if not _is_experiment(file)]


def unmeasured(file: Path) -> InputError:
    """Return the refusal of a film or an .rtdc file where what was measured in it is needed."""
    measured = file.with_suffix("")
    advice = f"run: capsbayes measure {file} --experiment EXPERIMENT --out {measured}"
    if _is_measured(file):
        return InputError(str(file), "", f"the folder of what was measured in it, {measured}", "the recording")
    return InputError(str(file), "", f"its capsules measured before, in the folder {measured}", "none", advice)


def _is_measured(file: Path) -> bool:
    return any((file.with_suffix("") / name).is_file() for name in _MEASURED)


def is_recording(file: Path) -> bool:
    """Return True for a video, a TIFF file of several pages or an .rtdc file, each of which shows many capsules."""
    suffix = file.suffix.lower()
    if suffix not in (".tif", ".tiff"):
        return suffix in (*VIDEOS, ".rtdc") and file.is_file()
    try:
        check_file(file)
        return is_film(file)
    except InputError:  # said when it is read
        return False


def _is_experiment(file: Path) -> bool:
    """Return True for the file of an experiment; a file that cannot be read is kept, to be refused by name."""
    try:
        content = InputFile.read(file).content
    except InputError:
        return False
    return not content.keys().isdisjoint(("cross_section", "section")) and "measurement" not in content


def _each_under_its_own(measurements: tuple[Measurement, ...]) -> tuple[tuple[Measurement, ...], Experiment]:
    """Return the first experiment, and the measurements with their own conditions if they name several."""
    advice = "give one for all with experiment=..., or --experiment"
    files = [measurement.named_experiment(advice).resolve() for measurement in measurements]
    known = {file: Experiment.read(file) for file in dict.fromkeys(files)}
    first = known[files[0]]
    for other in known.values():
        if other.cross_section != first.cross_section:
            expected = f"{first.cross_section!r} as in {first.source}"
            raise InputError(other.source, "cross_section", expected, repr(other.cross_section))
    if len(known) == 1:
        return measurements, first
    conditions = {file: {name: getattr(known[file], name).mean for name in CONDITIONS} for file in known}
    pairs = zip(measurements, files, strict=True)
    return tuple(replace(measurement, conditions=conditions[file]) for measurement, file in pairs), first


# A set as a table: lengths and velocities, one row a capsule, as a CSV, Parquet or NetCDF file or a pandas DataFrame.
#
# Headers or cells carry their units. The ``capsules.csv`` that the measurement of a film leaves is such a table too

Strings = NDArray[np.str_]

SHEETS = (".csv", ".xlsx")
"""Endings of the tables that a spreadsheet writes."""

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
    """Measured numbers of n capsules, as the rows of a table hold them."""

    numbers: Mapping[str, Floats]  # each of `NUMBERS`, (n,), NaN where it was not measured
    names: Strings
    refusals: Strings  # why a row cannot be used, empty if it can; "status: NAME" for that of a failed measurement
    source: str = ""
    sha256: str = ""
    priors: Mapping[str, Strings] = field(default_factory=dict)  # of G_s and a, texts; empty where a row has none

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def read(cls, path: str | Path) -> MeasuredLengths:
        """Read a CSV, .xlsx or Parquet table, or a NetCDF file without outlines."""
        path = Path(path)
        frame = _frame(path)
        return cls.of_frame(frame, source=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())

    @classmethod
    def of_frame(cls, frame: pd.DataFrame, *, source: str = "table", sha256: str = "") -> MeasuredLengths:
        """Take the numbers from a pandas DataFrame, of which cells may be quantities of pint, or texts with units."""
        import pandas as pd

        if not isinstance(frame, pd.DataFrame):
            raise InputError(source, "", "a path or a DataFrame", f"one of the type {type(frame).__name__}")
        frame = frame.rename(columns=lambda name: str(name).strip()).reset_index(drop=True)
        blank = blank_rows(frame)
        below = (np.cumsum(blank) > 0)[~blank]
        frame = _usual_columns(frame[~blank].reset_index(drop=True), source)
        _check_columns(source, list(frame.columns))
        if not len(frame):
            raise InputError(source, "", "at least one capsule", "none")
        if not sha256:
            sha256 = hashlib.sha256(pd.util.hash_pandas_object(frame).to_numpy().tobytes()).hexdigest()
        numbers, refusals = _numbers(frame)
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
                for word, statistic in _STATISTICS.items():
                    summary = statistic(above)
                    if np.all((np.abs(values[row] - summary) <= rounded * np.abs(summary))[varying]):
                        refusals[row] = f"name: expected a capsule, got the {word} of the rows above"
            if refusals[row] == "":
                above = np.concatenate([above, values[row : row + 1]])
        return replace(self, refusals=refusals.astype(np.str_))

    def _checked(self) -> MeasuredLengths:
        """Refuse the rows that no single measurement may hold."""
        numbers, checked = self.numbers, self
        length = numbers["axial_length"]
        velocity = np.isnan(numbers["flow_rate"]) | ~np.isnan([numbers[name] for name in _VELOCITY]).all(axis=0)
        for name in NUMBERS:
            if name == "length_correlation":
                continue
            given = ~np.isnan(length if name == "axial_length_error" else numbers[name]) | (name in _EXTENT)
            given = velocity if name in _VELOCITY else given
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

    def refused(self, rows: Booleans, name: str, expected: str) -> MeasuredLengths:
        """Return the same with further rows (n,) refused because of a number."""
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
        """Return one row as a measurement, unless it is refused."""
        where = f"{self.source}: capsule {self.names[row]}"
        if why := str(self.refusals[row]):
            key, _, words = why.partition(": ")
            expected, _, got = words.removeprefix("expected ").partition(", got ")
            if key == "status":
                expected, got = "DONE", str(Status.__members__.get(words, repr(words)))
            raise InputError(where, key, expected, got)
        numbers = {name: float(values[row]) for name, values in self.numbers.items() if np.isfinite(values[row])}
        if "axial_length" not in numbers:
            numbers.pop("axial_length_error", None)
        return _measurement_of(numbers, where)


def read_table(path: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a table of lengths."""
    known = known_experiment(path, experiment)
    lengths = MeasuredLengths.read(path)
    measurements, left_out = gathered([partial(lengths.measurement, row) for row in range(len(lengths))], path)
    return MeasuredSet(measurements, known, left_out)


def write_table(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write a table that `read_table` reads; refuse outlines, for which it has no place."""
    import pandas as pd

    if any(measurement.outline is not None for measurement in measurements):
        raise InputError(str(path), "outline", "capsules without outlines", "one with", "write a folder or a .nc")
    columns: dict[str, list[float | None]] = {}
    for name, heading in _USUAL.items():
        values = [seen.conditions.get(name) if name in CONDITIONS else getattr(seen, name) for seen in measurements]
        if any(value is not None for value in values):
            columns[heading] = values
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
        return pd.DataFrame({_USUAL.get(name, name): dataset[name].values for name in kept})
    with parsing(str(path), "a readable .parquet table"):
        try:
            return pd.read_parquet(io.BytesIO(raw))
        except ImportError:
            advice = "pip install 'capsbayes[parquet]', or write the table as .csv"
            raise InputError(str(path), "", "a reader of Parquet files", "none is installed", advice) from None


def _numbers(frame: pd.DataFrame) -> tuple[dict[str, Floats], NDArray[np.object_]]:
    """Return each of `NUMBERS` (n,) of a table in SI, and for each row why it holds none where it should, or ``""``."""
    import pandas as pd

    numbers = {name: np.full(len(frame), np.nan) for name in NUMBERS}
    refusals = np.full(len(frame), "", dtype=object)
    for name, headers in _HEADERS.items():
        header = next((header for header in headers if header in frame), None)
        if header is None:
            continue
        values = pd.to_numeric(frame[header], errors="coerce")
        numbers[name] = headers[header] * values.to_numpy(dtype=np.float64)
        for row in np.flatnonzero(values.isna() & ~frame[header].isna()).tolist():
            text = str(frame[header][row]).strip()
            if text.lower() not in MISSING:
                mistake, advice = mistake_in(text) or ("", "")
                got = f"{mistake} in {text!r}; {advice}" if mistake else repr(text)
                refusals[row] = refusals[row] or f"{header}: expected a number, got {got}"
    return numbers, refusals


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
            alike = get_close_matches(column, known, 1)
            advice = f"did you mean {alike[0]}?" if alike else "rename or remove it"
            got = f"{'an unknown' if column else 'a nameless'} one"
            raise InputError(source, column, "a column of a table of lengths", got, advice)
    by_rate = any(header in columns for header in _HEADERS["flow_rate"])
    for name in _EXTENT if by_rate else (*_EXTENT, *_VELOCITY):
        if not any(header in columns for header in _HEADERS[name]):
            advice = "or flow_rate_ul_per_min" if name in _VELOCITY else ""
            raise InputError(source, _USUAL[name], "a column of this name", f"only {', '.join(columns)}", advice)


# The forms of a set on disk: a folder of measurement files, a table of lengths, a file of outlines

_READERS = dict.fromkeys(SHEETS, read_table) | {".nc": read_netcdf}


def read_set(path: str | Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a folder of measurement files, a table (.csv, .xlsx) or a file of outlines; it may name its experiment."""
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
    """Write a table of lengths (.csv), a file of outlines (.nc), or a folder, which alone holds the experiment too."""
    path = Path(path)
    if path.suffix == ".csv":
        write_table(path, measurements)
    elif path.suffix == ".nc":
        write_netcdf(path, measurements)
    else:
        write_folder(path, measurements, experiment)
