"""Content of a set on disk: the capsules that can be compared, and why the others are omitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.measurement import Measurement


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
