"""``capsbayes build``: simulate many cases and keep them in one database."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import AsJson, Scheduler, Workers, choose, simulator_of, with_options_of
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError
from capsbayes.status import Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from capsbayes.database import Database


@with_options_of(simulator_of, "simulator")
def build(
    out: Annotated[
        Path,
        typer.Option(help="NetCDF file to write; finished cases are kept in OUT.parts."),
        Writes(".nc", next_to=("{name}.parts/",)),
    ],
    simulator: Any,
    cases: Annotated[
        Path | None, typer.Option(help="CSV file with the columns capillary_number and size_ratio."), Reads()
    ] = None,
    grid: Annotated[str | None, typer.Option(help="Instead of --cases: 'default', 418 cases.")] = None,
    effect: Annotated[
        str | None,
        typer.Option(help="One more parameter to vary over --values, as pre_inflation, or hardening of the law."),
    ] = None,
    values: Annotated[
        str | None, typer.Option(help="Values of --effect, as 0,0.01,0.05: at least three, the usual one among them.")
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    compare: Annotated[
        int | None, typer.Option(help="Refinement on which five cases are run again, to keep the mesh's error.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate many cases and write one database; a second run continues where the first stopped.

    Exit status: 0 done, 1 not one case converged, 2 bad input.
    """
    from capsbayes.physics.build import build_database

    chosen, varied = _chosen_cases(cases, grid), _values(effect, values)
    _require("--compare", compare is None or compare > simulator.refinement, "more than --refinement", compare)
    _require("--compare", compare is None or effect is None, "nothing with --effect", compare)

    def make() -> Database:
        how: dict[str, Any] = {"scheduler": scheduler, "workers": workers, "compare": compare}
        return build_database(simulator, chosen, out=out, effect=effect, values=varied, **how)

    report(make, out, as_json=as_json)


def report(make: Callable[[], Database], out: Path, *, as_json: bool) -> None:
    """Make a database and print the statuses of its cases; exit status 1 if not one case converged."""
    import time

    begin = time.perf_counter()
    database = make()
    seconds = round(time.perf_counter() - begin, 1)
    summary = {"file": str(out)} | database.as_dict() | {"seconds": seconds}
    if as_json:
        print_json(summary)
    else:
        typer.echo(f"{out}: {len(database)} cases in {seconds} s")
        for name, count in summary["statuses"].items():
            typer.echo(f"{count:6d}  {Status[name]}")
        typer.echo(f"sha256  {database.sha256}")
    if not len(database.converged):
        raise typer.Exit(1)


def _chosen_cases(cases: Path | None, grid: str | None) -> list[tuple[float, float]]:
    from capsbayes.physics.build import default_grid, read_cases

    if (cases is None) == (grid is None):
        raise InputError("build", "--cases, --grid", "one of the two", "neither" if cases is None else "both")
    if cases is not None:
        return read_cases(cases)
    choose("build", "--grid", str(grid), {"default": None})
    return default_grid()


def _values(effect: str | None, text: str | None) -> list[float]:
    """Return the numbers of --values, which comes with --effect."""
    if (effect is None) != (text is None):
        raise InputError("build", "--effect, --values", "both or neither", "only one")
    try:
        return [float(value) for value in (text or "").split(",") if value]
    except ValueError:
        raise InputError("build", "--values", "numbers with commas between them", repr(text)) from None


def _require(option: str, holds: bool, expected: str, got: object) -> None:
    if not holds:
        raise InputError("build", option, expected, str(got))
