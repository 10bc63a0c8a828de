"""``capsbayes population``: what many identified capsules have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, ExperimentFile, ModelName, Seed
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Reads
from capsbayes.errors import InputError

if TYPE_CHECKING:
    from capsbayes.infer.hierarchy import Hierarchy
    from capsbayes.infer.population import Population

_ENOUGH = 10  # capsules, for a population to be inferred unasked


def population(
    capsules: Annotated[
        Path,
        typer.Argument(help="NetCDF file of capsbayes batch; the result is stored in it too."),
        Reads(updated=True),
    ],
    least_stretch: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            max=10.0,
            help="Keep capsules with a larger Lambda only, as the published 1.04, and account for it.",
        ),
    ] = None,
    tails: Annotated[
        str, typer.Option(help="Of the population: normal, or student for t distributions, for a few odd capsules.")
    ] = "normal",
    database: ModelName = None,
    experiment: ExperimentFile = None,
    velocity_error: Annotated[
        str | None,
        typer.Option(help="Relative error that all velocities have in common, as '0.5 %': pixel size, frame rate."),
    ] = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Find mean and spread of G_s and a with the errors removed, and how G_s changes with a.

    Exit status: 0 if the intervals can be used, 1 if not, 2 on bad input.
    """
    from capsbayes.experiment import Experiment
    from capsbayes.infer.hierarchy import hierarchy
    from capsbayes.infer.population import Population
    from capsbayes.run import only_run
    from capsbayes.surrogate import Surrogate

    if not capsules.exists():
        raise InputError(str(capsules), "", "the file of a population", "nothing there")
    with only_run(capsules):
        read = Population.read(capsules)
        stored = least_stretch is None and database is None and read.limit is not None
        found = hierarchy(
            read,
            seed=seed,
            least_stretch=least_stretch,
            model=None if stored else Surrogate.open(database or read.attributes["model"]),
            experiment=None if experiment is None else Experiment.read(experiment),
            shared_velocity_error=_share(velocity_error),
            tails=tails,
        )
        if found.passed:
            found.added_to(read).write(capsules)
    if as_json:
        print_json(found.as_dict())
    else:
        from capsbayes.report.population import hierarchy_parts
        from capsbayes.report.tables import print_parts

        print_parts(*hierarchy_parts(found))
    if not found.passed:
        raise typer.Exit(1)


def together(read: Population, out: Path, *, seed: int) -> Hierarchy | None:
    """Infer what capsules have in common and store it with them; None if they are few, or of several experiments."""
    from capsbayes.infer.hierarchy import hierarchy

    if int(read.usable.sum()) < _ENOUGH:
        return None
    try:
        found = hierarchy(read, seed=seed)
    except InputError:
        return None
    if found.passed:
        found.added_to(read).write(out)
    return found


def _share(text: str | None) -> float:
    """Return a relative error, given as a number or in per cent."""
    if text is None:
        return 0.0
    try:
        number = float(text.replace("%", "").strip()) * (0.01 if "%" in text else 1.0)
    except ValueError:
        number = -1.0
    if not 0.0 <= number < 1.0:
        raise InputError("--velocity-error", "", "a share as '0.5 %' or 0.005", repr(text))
    return number
