"""``capsbayes population``: what many identified capsules have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, ExperimentFile, ModelName, Seed

if TYPE_CHECKING:
    from rich.console import Console

    from capsbayes.infer.many import Hierarchy, Population

_MUCH = 0.05  # of the capsules on the border
_ENOUGH = 10  # capsules, for a population to be looked for unasked


def population(
    capsules: Annotated[Path, typer.Argument(help="NetCDF file of capsbayes batch; the result is stored in it too.")],
    least_stretch: Annotated[
        float | None,
        typer.Option(help="Keep capsules with a larger Lambda only, as the published 1.04, and account for it."),
    ] = None,
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
    import json

    from rich.console import Console

    from capsbayes.experiment import Experiment
    from capsbayes.infer.many import Population, hierarchy
    from capsbayes.surrogate import Surrogate

    read = Population.read(capsules)
    found = hierarchy(
        read,
        seed=seed,
        least_stretch=least_stretch,
        model=None if least_stretch is None else Surrogate.open(database or read.attributes["model"]),
        experiment=None if experiment is None else Experiment.read(experiment),
        shared_velocity_error=_share(velocity_error),
    )
    if found.passed:
        found.added_to(read).write(capsules)
    if as_json:
        typer.echo(json.dumps(found.as_dict(), indent=2))
    else:
        print_hierarchy(Console(highlight=False), found)
    if not found.passed:
        raise typer.Exit(1)


def together(read: Population, out: Path, *, seed: int) -> Hierarchy | None:
    """What capsules have in common, stored beside them; None where they are few, or under several experiments."""
    from capsbayes.errors import InputError
    from capsbayes.infer.many import hierarchy

    if int(read.usable.sum()) < _ENOUGH:
        return None
    try:
        found = hierarchy(read, seed=seed)
    except InputError:
        return None
    if found.passed:
        found.added_to(read).write(out)
    return found


def print_hierarchy(console: Console, found: Hierarchy) -> None:
    """Print medians and 95 % intervals, and what they are owed to."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    kept = "" if found.least_stretch is None else f" with Lambda above {found.least_stretch:g}, which is accounted for"
    title = f"The population: {found.capsules} capsules{kept}, their errors removed"
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("", "median", "95 %"):
        table.add_column(heading, justify="left" if not heading else "right", no_wrap=True)
    for name, one in found.marginals.items():
        about = PARAMETERS[name]
        middle, low, high = (about.shown(value) for value in (one.median, one.lower_95, one.upper_95))
        table.add_row(escape(about.label), f"{middle:.3g}", f"{low:.3g} to {high:.3g}")
    console.print(table)
    owed = ", ".join(f"{PARAMETERS[name].symbol} {share:.0%}" for name, share in found.shared_share.items())
    console.print(f"Of the variance of the medians, owed to what all capsules share: {owed}.", markup=False)
    if found.leaning > _MUCH:
        console.print(
            f"{found.leaning:.0%} of the capsules lean on the border of the model: the population may go on beyond it.",
            markup=False,
        )
    for gate in found.gates:
        if not gate.passed:
            console.print(f"Do not use the intervals: {gate}", markup=False)


def _share(text: str | None) -> float:
    """A relative error: a number, or one in percent."""
    from capsbayes.errors import InputError

    if text is None:
        return 0.0
    try:
        number = float(text.replace("%", "").strip()) * (0.01 if "%" in text else 1.0)
    except ValueError:
        number = -1.0
    if not 0.0 <= number < 1.0:
        raise InputError("--velocity-error", "", "a share as '0.5 %' or 0.005", repr(text))
    return number
