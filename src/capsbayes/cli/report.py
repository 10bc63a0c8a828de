"""``capsbayes report``: a result as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import AsJson
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError


def report(
    result: Annotated[
        str,
        typer.Argument(
            help="Folder or posterior.nc of capsbayes identify, .nc file of a population or of a database, or name of "
            "a shipped database."
        ),
        Reads(),
    ],
    out: Annotated[Path, typer.Option(help="HTML file to write."), Writes(".html", ".htm")] = Path("report.html"),
    picture: Annotated[
        Path | None,
        typer.Option(help="Of a posterior: picture of the capsule; default: the one it was measured in."),
        Reads(),
    ] = None,
    rows: Annotated[int, typer.Option(min=1, help="Of a population: most capsules in the table, worst first.")] = 500,
    as_json: AsJson = False,
) -> None:
    """Write a result as one HTML page that holds its pictures, to read on a screen or a phone and to print."""
    from rich.console import Console

    from capsbayes.infer import Posterior
    from capsbayes.report import opened, write_report
    from capsbayes.run import only_run

    found, source = opened(result)
    if picture is not None and not isinstance(found, Posterior):
        raise InputError("report", "--picture", "a posterior with a picture", source)
    with only_run(out), Console(stderr=True).status("Drawing ..."):
        path = write_report(found, out, picture=picture, rows=rows, source=source)
    size = path.stat().st_size
    if as_json:
        print_json({"file": str(path), "bytes": size})
    else:
        typer.echo(f"Written to {path}, {size / 1e6:.1f} MB.")
