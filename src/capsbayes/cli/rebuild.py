"""``capsbayes rebuild``: compute a database that comes with the library again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import AsJson, Scheduler, Workers
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Writes


def rebuild(
    name: Annotated[str, typer.Argument(help="Name of the database, as square-neo-hookean, or membrane-square.")],
    out: Annotated[
        Path,
        typer.Option(help="NetCDF file to write; finished cases are kept in OUT.parts."),
        Writes(".nc", next_to=("{name}.parts/",)),
    ],
    full: Annotated[
        bool, typer.Option("--full", help="Keep the nodes of the membrane and outlines in double precision.")
    ] = False,
    scheduler: Scheduler = None,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Simulate every case of a shipped database; a second run continues where the first stopped.

    Exit status: 0 done, 1 not one case converged, 2 bad input.
    """
    from capsbayes.cli.build import report
    from capsbayes.physics.recipes import build_shipped
    from capsbayes.physics.scattered import MEMBRANES, build_membranes

    if name in MEMBRANES:
        states = build_membranes(name, out=out, scheduler=scheduler, workers=workers).as_dict()
        if as_json:
            print_json({"file": str(out)} | states)
        else:
            typer.echo(f"{out}: {states['states']} states, {states['lost']} lost\nsha256  {states['sha256']}")
        return
    report(lambda: build_shipped(name, out=out, full=full, scheduler=scheduler, workers=workers), out, as_json=as_json)
