"""``capsbayes atlas``: the maps of a database."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import AsJson, DatabaseName
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Writes
from capsbayes.files.output_file import together


def atlas(
    database: DatabaseName,
    out: Annotated[Path, typer.Option(help="Folder for the pictures."), Writes(within=("*.png",))] = Path("atlas"),
    as_json: AsJson = False,
) -> None:
    """Draw what a database covers: its cases and borders, velocities, lengths and shapes."""
    from rich.console import Console

    from capsbayes.database import Database
    from capsbayes.report.database import atlas as figures_of
    from capsbayes.report.style import write_figure
    from capsbayes.run import resumable

    whole = Database.open(database)
    with resumable(out), Console(stderr=True).status("Drawing ..."):
        figures = figures_of(whole)
        paths = [out / f"{name}.png" for name in figures]
        with together():
            for path, figure in zip(paths, figures.values(), strict=True):
                write_figure(figure, path)
    if as_json:
        files = [{"file": str(path), "bytes": path.stat().st_size} for path in paths]
        counts = {"cases": len(whole), "converged": len(whole.converged)}
        print_json({"sha256": whole.sha256, **counts, "files": files})
        return
    typer.echo(f"{len(whole.converged)} of {len(whole)} cases with a steady state")
    for path in paths:
        typer.echo(f"  {path}  {path.stat().st_size / 1000:.0f} kB")
