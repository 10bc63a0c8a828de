"""A set as a folder: one measurement file a capsule, and the experiment's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from capsbayes.discrepancy.sets.measured_set import MeasuredSet, gathered, known_experiment
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.input_file import InputFile
from capsbayes.measurement import Measurement

__all__ = ["read_folder", "write_folder"]

_EXPERIMENT = "experiment.toml"


def read_folder(folder: Path, experiment: Experiment | str | Path | None = None) -> MeasuredSet:
    """Read the measurement files of a folder and those one folder down, as a film leaves them.

    Parameters
    ----------
    folder : Path
        Each file as `Measurement.read` reads it; files of experiments among them are passed over.
    experiment : Experiment or path, optional
        By default the one that all measurements name.

    Raises
    ------
    InputError
        If no capsule can be used, or they do not name the same experiment.
    """
    files = [*sorted(folder.glob("*.toml")), *sorted(folder.glob("*/measurement.toml"))]
    readers = [partial(Measurement.read, file) for file in files if not _is_experiment(file)]
    measurements, left_out = gathered(readers, folder)
    known = _named_by_all(folder, measurements) if experiment is None else experiment
    return MeasuredSet(measurements, known_experiment(folder, known), left_out)


def write_folder(folder: Path, measurements: Sequence[Measurement], experiment: Experiment) -> None:
    """Write ``experiment.toml`` and ``capsule-001.toml``, ``capsule-002.toml``, and so on.

    Raises
    ------
    InputError
        If the folder holds TOML files already, which would be read as well.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.glob("*.toml"))):
        got = "one with TOML files" if folder.is_dir() else "a file"
        raise InputError(str(folder), "", "a folder without TOML files", got, "choose another")
    folder.mkdir(parents=True, exist_ok=True)
    experiment.write(folder / _EXPERIMENT)
    digits = max(3, len(str(len(measurements))))
    for number, one in enumerate(measurements, start=1):
        named = replace(one, experiment_file=folder / _EXPERIMENT)
        named.write(folder / f"capsule-{number:0{digits}d}.toml")


def _is_experiment(file: Path) -> bool:
    try:
        content = InputFile.read(file).content
    except InputError:
        return False
    return "section" in content and "measurement" not in content


def _named_by_all(folder: Path, measurements: Sequence[Measurement]) -> Path:
    advice = "give one for all with experiment=..., or --experiment"
    first = measurements[0]
    for one in measurements:
        if one.experiment_file is None:
            raise InputError(one.source, "experiment", "the name of a file", "nothing", advice)
        assert first.experiment_file is not None, "looked at before the others"
        if one.experiment_file.resolve() != first.experiment_file.resolve():
            expected = f"the same experiment as in {first.source}, {first.experiment_file}"
            raise InputError(one.source, "experiment", expected, str(one.experiment_file), advice)
    assert first.experiment_file is not None, "all name one"
    return first.experiment_file
