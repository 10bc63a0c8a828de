"""What the commands of ``capsbayes sensitivity`` read: a measured capsule, its experiment, the errors of a lab."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from capsbayes.cli.options import named_experiment

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.plan import LabErrors


def read_lab(
    command: str,
    like: Path | None,
    experiment: Path | None,
    extent_error: float | None,
    length_error: float | None,
    velocity_error: float | None,
) -> tuple[LabErrors, Experiment]:
    """Errors of a lab and its experiment: those of a measured capsule, or those that are stated."""
    from capsbayes.errors import InputError
    from capsbayes.experiment import Experiment
    from capsbayes.measurement import Measurement
    from capsbayes.plan import LabErrors

    stated = {"--extent-error": extent_error, "--length-error": length_error, "--velocity-error": velocity_error}
    if like is not None:
        for option, value in stated.items():
            if value is not None:
                raise InputError(command, option, "no such option together with --like", f"{value:g}")
        measurement = Measurement.read(like)
        if measurement.outline is not None:
            typer.echo(
                f"The widths are those of the lengths of {like}; its outline would make them narrower.", err=True
            )
        return LabErrors.of(measurement), named_experiment(measurement, experiment)
    if experiment is None or extent_error is None or velocity_error is None:
        given = ", ".join(name for name, value in stated.items() if value is not None) or "none of them"
        expected = "--like CAPSULE, or --experiment with --extent-error and --velocity-error"
        raise InputError(command, "errors", expected, given if experiment is None else f"--experiment, {given}")
    return LabErrors(extent_error, velocity_error, length_error), Experiment.read(experiment)
