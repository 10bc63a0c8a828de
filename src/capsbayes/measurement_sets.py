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
    """Capsules of one session, as a file or a folder holds them.

    Parameters
    ----------
    measurements : tuple of Measurement
    experiment : Experiment
    left_out : tuple of str
        One line for each capsule that cannot be used.
    """

    measurements: tuple[Measurement, ...]
    experiment: Experiment
    left_out: tuple[str, ...] = ()


def check_comparable(measurement: Measurement, where: str) -> None:
    """Refuse a measurement that failed, or whose lengths are in metres, or whose outline is not over l along the flow.

    Raises
    ------
    InputError
    """
    if not measurement.status.ok:
        raise InputError(where, "status", "a measurement that is done", str(measurement.status), "leave it out")
    if not measurement.over_half_width:
        raise InputError(where, "axial_extent", "lengths over l", "lengths in metres", "divide by l")
    measurement.check_outline(where)


def gathered(
    readers: Iterable[Callable[[], Measurement]], where: Path
) -> tuple[tuple[Measurement, ...], tuple[str, ...]]:
    """Return the capsules that can be read and compared, and one line for each of the others.

    Parameters
    ----------
    readers : iterable of functions
        Each reads one capsule.
    where : Path
        Of the set.

    Raises
    ------
    InputError
        If no capsule can be used.
    """
    found: list[Measurement] = []
    left_out: list[str] = []
    for read in readers:
        try:
            measurement = read()
            check_comparable(measurement, measurement.source)
            found.append(measurement)
        except InputError as error:
            left_out.append(str(error))
    if not found:
        reason = f"{len(left_out)} that cannot be used, the first because of {left_out[0]}" if left_out else "none"
        raise InputError(str(where), "", "at least one capsule", reason)
    return tuple(found), tuple(left_out)


def known_experiment(path: Path, experiment: Experiment | str | Path | None) -> Experiment:
    """Return the experiment that is given, read if it is a file.

    Raises
    ------
    InputError
        If no experiment is given.
    """
    if experiment is None:
        advice = "say which with experiment=..., or --experiment"
        raise InputError(str(path), "experiment", "the experiment of the capsules", "nothing", advice)
    return experiment if isinstance(experiment, Experiment) else Experiment.read(experiment)


# Columns of a table with units: in the heading, or in each cell, as a text or as a quantity of pint

_WITH_UNIT = re.compile(r"(?P<name>\w+)\s*[\[(](?P<unit>[^\])]*)[\])]")
_STATES_ERROR = re.compile(r"±|\+\s?/?\s?-")
_ERROR = "_error"


def usual_columns(frame: pd.DataFrame, headings: Mapping[str, str], source: str) -> pd.DataFrame:
    """Return a table whose columns have the usual headings, for one whose columns may be headed otherwise.

    Parameters
    ----------
    frame : DataFrame
        ``capsule_velocity [mm/s]`` is a column of numbers, or of texts as ``"4.86 +/- 0.04"``, in this unit;
        ``capsule_velocity`` one of numbers in SI (of lengths, over l), of quantities of pint, or of texts as
        ``"4.86 +/- 0.04 mm/s"``. The errors of texts make a column of their own.
    headings : mapping of str
        Usual heading, which is that of SI, of each number by its name.
    source : str
        For the message of an error.

    Raises
    ------
    InputError
        On a unit that cannot be read or is not that of the number, or if two columns state the same number.
    """
    columns: dict[str, Any] = {}
    for heading, values in frame.items():
        found = _WITH_UNIT.fullmatch(str(heading))
        name = found["name"] if found else str(heading)
        if name not in headings or (name == headings[name] and not found):
            made = {str(heading): values}
        elif found:
            made = _of_cells(name, values, headings, *_factor(name, found["unit"], source, str(heading)))
        else:
            made = _of_cells(name, values, headings)
        for key, of in made.items():
            if key in columns:
                raise InputError(source, str(heading), "one statement of each number", f"a second one of {key}")
            columns[key] = of
    return type(frame)(columns)


def _target(name: str) -> str:
    """Return the SI unit of a number, empty for a ratio."""
    base = name.removesuffix(_ERROR)
    return PARAMETERS[base].si if base in PARAMETERS else ""


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
    found = parsed(f"1 {unit}", (target,), where=source, key=heading, wanted=wanted)
    if found.second or found.is_range:
        raise InputError(source, heading, wanted, repr(unit))
    return found.first, unit


def _of_cells(
    name: str, values: pd.Series, headings: Mapping[str, str], factor: float = 1.0, unit: str = ""
) -> dict[str, Any]:
    """Return the column of a number, and that of its errors if its cells state any."""
    import pandas as pd

    if pd.api.types.is_numeric_dtype(values.dtype) and values.dtype.kind in "fiu":
        return {headings[name]: factor * values}
    cells = [_cell(value, name, factor, unit) for value in values]
    if f"{name}{_ERROR}" not in headings:  # as of a viscosity, whose error is that of the experiment
        cells = [(str(value), np.nan) if cell[1] > 0.0 else cell for value, cell in zip(values, cells, strict=True)]
    made = {headings[name]: pd.Series([cell[0] for cell in cells], index=values.index, dtype=object)}
    errors = np.array([cell[1] for cell in cells])
    stated = any(isinstance(cell[0], str) and _STATES_ERROR.search(cell[0]) for cell in cells) or np.any(errors > 0.0)
    if stated and f"{name}{_ERROR}" in headings:
        made[headings[f"{name}{_ERROR}"]] = pd.Series(errors, index=values.index)
    return made


def _cell(value: Any, name: str, factor: float, unit: str) -> tuple[Any, float]:
    """Return value and error in SI of a cell, by its column's unit; one that cannot be read as it is, to be refused."""
    if (
        value is None
        or (isinstance(value, float) and np.isnan(value))
        or (isinstance(value, str) and not value.strip())
    ):
        return np.nan, np.nan
    target, text = _target(name), isinstance(value, str)
    try:
        read = Quantity.of(
            f"{value} {unit}" if text and unit else value, units=(target,), where="table", key=name, signed=True
        )
    except InputError:
        return str(value), np.nan
    if read.shape != "normal":
        return str(value), np.nan
    scale = 1.0 if text else factor
    return scale * read.value, scale * read.error if read.error else np.nan


# A set as one NetCDF file: outlines of all capsules with their lengths, velocities and noise

# numbers over the capsules
_NEEDED_VARIABLES = ("axial_extent", "axial_extent_error")
_VELOCITY_VARIABLES = ("capsule_velocity", "capsule_velocity_error")
_LENGTH = ("axial_length", "axial_length_error")
_RATE = ("flow_rate", "flow_rate_error")
_NOISE = {"noise_scale": "l", "noise_correlation": "l", "noise_white": "1"}
_UNITS = {
    name: PARAMETERS[name.removesuffix("_error")].unit
    for name in (*_NEEDED_VARIABLES, *_VELOCITY_VARIABLES, *_LENGTH, *_RATE, *CONDITIONS)
}
_OUTLINE = ("capsule", "point", "axis")


def read_netcdf(path: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read a file of outlines.

    Parameters
    ----------
    path : Path
        With the variables ``outline`` (capsule, point, axis) [l], columns (z, y), filled up with NaN behind a short
        one; over the capsules ``axial_extent``, ``axial_extent_error`` [l], ``capsule_velocity``,
        ``capsule_velocity_error`` [m/s] or ``flow_rate`` and ``flow_rate_error`` [m^3/s] or all four, ``noise_scale``,
        ``noise_correlation`` [l] as of `OutlineNoise`; optionally ``noise_white``, ``axial_length``,
        ``axial_length_error`` [l], ``half_width`` [m] and ``viscosity`` [Pa s] where they are not those of the
        experiment (else NaN), and ``name``. A variable's attribute ``units``, if it has one, must be the unit here.
        The attribute ``view`` says what all outlines show, ``"mid-plane"`` by default.
    experiment : Experiment or path
        By default the file that the attribute ``experiment`` names, relative to this one.

    Raises
    ------
    InputError
        On a variable that is missing or of another shape or unit, or if no capsule can be used.
    """
    dataset = opened(path)
    named = dataset.attrs.get("experiment")
    known = known_experiment(path, path.parent / str(named) if experiment is None and named else experiment)
    _check(path, dataset)
    readers = [partial(_measurement, path, dataset, row) for row in range(dataset.sizes["capsule"])]
    measurements, left_out = gathered(readers, path)
    return MeasuredSet(measurements, known, left_out)


def write_netcdf(path: Path, measurements: Sequence[Measurement]) -> None:
    """Write a file that `read_netcdf` reads.

    Raises
    ------
    InputError
        If a capsule has no outline, or one with another `Pose` than the usual, or if they differ in their view.
    """
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
    noises = [outline.noise for outline in outlines]
    noise = np.array([[noise.scale, noise.correlation_length, noise.white] for noise in noises])
    numbers = {
        name: [getattr(seen, name) for seen in measurements]
        for name in (*_NEEDED_VARIABLES, *_VELOCITY_VARIABLES, *_LENGTH)
    }
    numbers |= dict(zip(_NOISE, noise.T, strict=True))
    own = {name: [seen.conditions.get(name, np.nan) for seen in measurements] for name in CONDITIONS}
    own |= {name: [getattr(seen, name) or np.nan for seen in measurements] for name in _RATE}
    numbers |= {name: values for name, values in own.items() if np.isfinite(values).any()}
    units = _UNITS | _NOISE
    variables = {name: ("capsule", np.array(values, float), {"units": units[name]}) for name, values in numbers.items()}
    dataset = xr.Dataset({**variables, "outline": (_OUTLINE, points, {"units": "l"})}, coords={"axis": ["z", "y"]})
    dataset.attrs["view"] = (views or [MID_PLANE])[0]
    write_dataset(path, dataset)


def opened(path: Path) -> xr.Dataset:
    """Return the content of a NetCDF file.

    Raises
    ------
    InputError
        If it is none, or damaged.
    """
    check_file(path, "NetCDF file")
    with parsing(str(path), "a NetCDF file"), xr.open_dataset(path, engine="h5netcdf") as opened:
        return opened.load()


def _check(path: Path, dataset: xr.Dataset) -> None:
    """Refuse a file that lacks a variable, or has one of another shape or unit."""
    velocity = () if "flow_rate" in dataset.variables else _VELOCITY_VARIABLES
    needed = ("outline", *_NEEDED_VARIABLES, *velocity, "noise_scale", "noise_correlation")
    for name, unit in {"outline": "l", **_UNITS, **_NOISE}.items():
        dims = _OUTLINE if name == "outline" else ("capsule",)
        wanted = f"a variable ({', '.join(dims)}) in {unit}"
        if name not in dataset.variables:
            if name in needed:
                raise InputError(str(path), name, wanted, "nothing", "add the missing variable")
            continue
        found = dataset[name]
        if found.dims != dims or found.dtype.kind not in "fiu" or (name == "outline" and found.shape[2] != 2):
            sizes = ", ".join(f"{dim}: {size}" for dim, size in found.sizes.items())
            raise InputError(str(path), name, wanted, f"one of {found.dtype} ({sizes})")
        if str(found.attrs.get("units", unit)) != unit:
            raise InputError(str(path), name, wanted, f"one in {found.attrs['units']}", "convert it")


def _measurement(path: Path, dataset: xr.Dataset, row: int) -> Measurement:
    capsule = dataset.isel(capsule=row)
    label = str(capsule["name"].item()) if "name" in capsule.variables else str(row + 1)
    where = f"{path}: capsule {label}"
    names = (*_NEEDED_VARIABLES, *_VELOCITY_VARIABLES, *_LENGTH, *_RATE)
    numbers = {name: float(capsule[name]) for name in names if name in capsule.variables}
    needed = (
        _NEEDED_VARIABLES
        if np.isfinite(numbers.get("flow_rate", np.nan))
        else (*_NEEDED_VARIABLES, *_VELOCITY_VARIABLES)
    )
    seen = {name: value for name, value in numbers.items() if name in needed or np.isfinite(value)}
    points = np.asarray(capsule["outline"].values, np.float64)
    view = check_view(capsule.attrs.get("view", MID_PLANE), str(path), "view")
    white = float(capsule["noise_white"]) if "noise_white" in capsule.variables else 0.0
    try:
        noise = OutlineNoise(float(capsule["noise_scale"]), float(capsule["noise_correlation"]), white)
        outline = MeasuredOutline(points[np.isfinite(points).any(axis=1)], noise, view=view)
    except InputError as error:  # which does not know whose outline it is
        raise InputError(where, error.key, error.expected, error.got, error.advice) from None
    own = {
        name: float(capsule[name]) for name in CONDITIONS if name in capsule.variables and np.isfinite(capsule[name])
    }
    return Measurement(**seen, outline=outline, conditions=own, source=where)  # type: ignore[arg-type]


# A set as a folder: one measurement file for each capsule, and the file of the experiment

_EXPERIMENT = "experiment.toml"
_MEASURED = ("capsules.csv", "events.csv")  # that measuring a film or an .rtdc file leaves


def read_folder(folder: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read the measurement files of a folder and those that films and .rtdc files left in folders within it.

    Parameters
    ----------
    folder : Path
        Each file as `Measurement.read` reads it; files of experiments among them are ignored.
    experiment : Experiment or path, optional
        Default: the one that each measurement names. Several must share one cross-section; each capsule keeps the half
        width and the viscosity of its own experiment.

    Raises
    ------
    InputError
        If no capsule can be used, or one names no experiment, or their experiments have different cross-sections.
    """
    readers = [partial(Measurement.read, file) for file in measurement_files(folder)]
    measurements, left_out = gathered(readers, folder)
    if experiment is None:
        measurements, known = _each_under_its_own(measurements)
    else:
        known = known_experiment(folder, experiment)
    return MeasuredSet(measurements, known, left_out)


def write_folder(folder: Path, measurements: Sequence[Measurement], experiment: Experiment) -> None:
    """Write ``experiment.toml`` and ``capsule-001.toml``, ``capsule-002.toml``, and so on.

    Raises
    ------
    InputError
        If the folder holds TOML files already, which would be read as well, or a capsule has conditions of its own.
    """
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
    """Return the measurement files of a folder, and each ``measurement.toml`` of a folder anywhere within it.

    A film or an .rtdc file leaves a folder for each capsule, several of them a folder of such folders. Files of
    experiments among them are ignored.

    Raises
    ------
    InputError
        If a film or an .rtdc file lies in the folder without a folder of its name with what was measured in it.
    """
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
    files = [_named(measurement) for measurement in measurements]
    known = {file: Experiment.read(file) for file in dict.fromkeys(files)}
    first = known[files[0]]
    for other in known.values():
        if other.cross_section != first.cross_section:
            expected = f"{first.cross_section!r} as in {first.source}"
            raise InputError(other.source, "cross_section", expected, repr(other.cross_section))
    if len(known) == 1:
        return measurements, first
    conditions = {
        file: {name: getattr(experiment, name).mean for name in CONDITIONS} for file, experiment in known.items()
    }
    own = [
        replace(measurement, conditions=conditions[file]) for measurement, file in zip(measurements, files, strict=True)
    ]
    return tuple(own), first


def _named(measurement: Measurement) -> Path:
    if measurement.experiment_file is None:
        advice = "give one for all with experiment=..., or --experiment"
        raise InputError(measurement.source, "experiment", "the name of a file", "nothing", advice)
    return measurement.experiment_file.resolve()


# A set as a table: lengths and velocities, one row a capsule, as a CSV, Parquet or NetCDF file or a pandas DataFrame.
#
# Headers or cells carry their units. Lengths are over l; velocities may be in m/s or mm/s. The ``capsules.csv`` that
# the
# measurement of a film leaves is such a table too

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
            their own, see `capsbayes.measurement_sets.usual_columns`.

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
                    name, advice = mistake_in(text) or ("", "")
                    got = f"{name} in {text!r}; {advice}" if name else repr(text)
                    refusals[row] = refusals[row] or f"{header}: expected a number, got {got}"
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
            alike = get_close_matches(column, known, 1)
            advice = f"did you mean {alike[0]}?" if alike else "rename or remove it"
            got = f"{'an unknown' if column else 'a nameless'} one"
            raise InputError(source, column, "a column of a table of lengths", got, advice)
    by_rate = any(header in columns for header in _HEADERS["flow_rate"])
    for name in _NEEDED if by_rate else (*_NEEDED, *_VELOCITY_PAIR):
        if not any(header in columns for header in _HEADERS[name]):
            advice = "or flow_rate_ul_per_min" if name in _VELOCITY_PAIR else ""
            header, got = next(iter(_HEADERS[name])), f"only {', '.join(columns)}"
            raise InputError(source, header, "a column of this name", got, advice)


# The forms of a set on disk: a folder of measurement files, a table of lengths, a file of outlines

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
