"""``capsbayes build``: simulate many cases and keep them in one database."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from capsbayes.database import Database


def build(
    out: Annotated[Path, typer.Option(help="NetCDF file to write; finished cases are kept in OUT.parts.")],
    law: Annotated[str, typer.Option(help="Membrane law.")] = "neo-hookean",
    section: Annotated[str, typer.Option(help="Section of the channel.")] = "square",
    refinement: Annotated[int, typer.Option(help="Fineness n of the mesh: 8 is quick, 12 is fit to publish.")] = 8,
    bending: Annotated[float, typer.Option(help="Bending stiffness B over G_s a^2.")] = 2e-4,
    pre_inflation: Annotated[float, typer.Option(help="Osmotic pre-inflation alpha of the radius.")] = 0.0,
    cases: Annotated[
        Path | None, typer.Option(help="CSV file with the columns capillary_number and size_ratio.")
    ] = None,
    grid: Annotated[str | None, typer.Option(help="Instead of --cases: 'default', 380 cases.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask cluster, tcp://host:port; otherwise this machine.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Worker processes on this machine; one a core if absent.")] = None,
    compare: Annotated[
        int | None, typer.Option(help="Refinement on which five cases are run again, to keep the mesh's error.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Simulate many cases and write one database; started again, it goes on where it was.

    Exit status: 0 done, 1 not one case converged, 2 bad input.
    """
    import json
    import time

    from capsbayes.cli.choices import one_of
    from capsbayes.membrane import LAWS
    from capsbayes.simulation.build import build_database

    chosen = _chosen_cases(cases, grid)
    membrane = one_of("build", "--law", law, LAWS)
    one_of("build", "--section", section, {"square": None})
    _require("--refinement", refinement >= 2, "a whole number from 2 on", refinement)
    _require("--bending", bending >= 0.0, "a number not below 0", bending)
    _require("--pre-inflation", pre_inflation >= 0.0, "a number not below 0", pre_inflation)
    _require("--compare", compare is None or compare > refinement, "more than --refinement", compare)
    _require("--workers", workers is None or workers >= 1, "at least 1", workers)
    from capsbayes.simulation import Simulator  # slow to import: after every check of the input

    simulator = Simulator(
        law=membrane(), section=section, refinement=refinement, bending=bending, pre_inflation=pre_inflation
    )
    begin = time.perf_counter()
    database = build_database(simulator, chosen, out=out, scheduler=scheduler, workers=workers, compare=compare)
    summary = _summary(database, out, time.perf_counter() - begin)
    typer.echo(json.dumps(summary, indent=2) if as_json else _as_text(summary))
    if not len(database.converged):
        raise typer.Exit(1)


def _chosen_cases(cases: Path | None, grid: str | None) -> list[tuple[float, float]]:
    from capsbayes.cli.choices import one_of
    from capsbayes.errors import InputError
    from capsbayes.simulation.grid import default_grid, read_cases

    if (cases is None) == (grid is None):
        raise InputError("build", "--cases, --grid", "one of the two", "neither" if cases is None else "both")
    if cases is not None:
        return read_cases(cases)
    one_of("build", "--grid", str(grid), {"default": None})
    return default_grid()


def _require(option: str, holds: bool, expected: str, got: object) -> None:
    from capsbayes.errors import InputError

    if not holds:
        raise InputError("build", option, expected, str(got))


def _summary(database: Database, out: Path, seconds: float) -> dict[str, Any]:
    from collections import Counter

    return {
        "file": str(out),
        "sha256": database.sha256,
        "cases": len(database),
        "statuses": dict(Counter(map(str, database["status"])).most_common()),
        "seconds": round(seconds, 1),
    }


def _as_text(summary: dict[str, Any]) -> str:
    from capsbayes.status import Status

    lines = [f"{summary['file']}: {summary['cases']} cases in {summary['seconds']} s"]
    lines += [f"{count:6d}  {Status[name]}" for name, count in summary["statuses"].items()]
    return "\n".join([*lines, f"sha256  {summary['sha256']}"])
