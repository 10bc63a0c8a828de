"""A set as a folder: one measurement file for each capsule, and the file of the experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import VIDEOS, InputFile, check_file
from capsbayes.files.recording import is_film
from capsbayes.measurement import CONDITIONS, Measurement
from capsbayes.measurements.measured_set import MeasuredSet, gathered, known_experiment

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
        measured = folder / file.stem
        if is_recording(file) and not any((measured / name).is_file() for name in _MEASURED):
            expected = f"its capsules measured before, in the folder {measured}"
            advice = f"run: capsbayes measure {file} --experiment EXPERIMENT --out {measured}"
            raise InputError(str(file), "", expected, "none", advice)
    files = [*sorted(folder.glob("*.toml")), *sorted(folder.glob("*/**/measurement.toml"))]
    return [file for file in files if not _is_experiment(file)]


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
