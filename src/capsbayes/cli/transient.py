"""``capsbayes transient``: motion of one capsule from rest to the steady state."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import AsJson, CapillaryNumber, Plot, SizeRatio, simulator_of, with_options_of
from capsbayes.cli.output import print_json, table_file
from capsbayes.cli.paths import Writes
from capsbayes.files.output_file import together

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capsbayes.physics.simulator import Snapshot


@with_options_of(simulator_of, "simulator")
def transient(
    capillary_number: CapillaryNumber,
    size_ratio: SizeRatio,
    until: Annotated[float, typer.Option(help="Time U t / l at which to end.")],
    simulator: Any,
    every: Annotated[float, typer.Option(help="Time U dt / l between two rows of the table.")] = 0.2,
    viscosity_ratio: Annotated[float, typer.Option(help="Viscosity inside over that outside: 1.")] = 1.0,
    scheme: Annotated[str, typer.Option(help="Time steps: semi-implicit or explicit.")] = "semi-implicit",
    table: Annotated[Path | None, typer.Option(help="Write the table, a .csv file."), Writes(".csv")] = None,
    paraview: Annotated[
        Path | None,
        typer.Option(help="Write the membranes to a .pvd file for ParaView."),
        Writes(".pvd", next_to=("{stem}-*.vtu",)),
    ] = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Follow one capsule from rest and print its lengths and velocity over time.

    The run ends before `until` once the capsule is steady. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.physics.simulator import save_series
    from capsbayes.report.tables import print_parts
    from capsbayes.report.tables import table as rendered

    way = simulator.transient(
        capillary_number=capillary_number,
        size_ratio=size_ratio,
        until=until,
        every=every,
        scheme=scheme,
        viscosity_ratio=viscosity_ratio,
    )
    snapshots = _followed(way, until)
    lengths = rendered(list(_COLUMNS.values()), map(_row, snapshots), numbers=range(len(_COLUMNS)))
    if as_json:
        print_json([_record(snapshot) for snapshot in snapshots])
    else:
        print_parts(lengths, _end(snapshots[-1]))
    with together():
        if table is not None:
            table_file(lengths, header=list(_COLUMNS), index=False)(table)
        if paraview is not None:
            save_series(snapshots, paraview)
        if plot is not None:
            from capsbayes.report.simulation import transient_figure
            from capsbayes.report.style import write_figure

            write_figure(transient_figure(_chosen(snapshots)), plot)


def _followed(way: Iterator[Snapshot], until: float) -> list[Snapshot]:
    """Return all snapshots; show a progress bar on a terminal."""
    from capsbayes.run import progress_bar

    snapshots = []
    with progress_bar(until, "l / U") as update:
        for snapshot in way:
            snapshots.append(snapshot)
            update(snapshot.time)
    return snapshots


_COLUMNS = {
    "time": "U t / l",
    "axial_extent": "L_z / l",
    "axial_length": "L_a / l",
    "velocity_ratio": "v_o / U",
    "speed": "speed / U",
}


def _row(snapshot: Snapshot) -> list[str]:
    profile = snapshot.profile
    lengths = (profile.axial_extent, profile.axial_length, snapshot.velocity_ratio)
    return [f"{snapshot.time:.4g}", *(f"{value:.4f}" for value in lengths), f"{snapshot.speed:.1e}"]


def _record(snapshot: Snapshot) -> dict[str, float]:
    profile = snapshot.profile
    numbers = snapshot.time, profile.axial_extent, profile.axial_length, snapshot.velocity_ratio, snapshot.speed
    return dict(zip(_COLUMNS, map(float, numbers), strict=True))


def _end(last: Snapshot) -> str:
    from capsbayes.physics.transient import STEADY

    if last.speed < STEADY:
        return "Steady."
    return f"Not yet steady: the fastest node moves at {last.speed:.2g} U, seen from the centroid."


def _chosen(snapshots: list[Snapshot]) -> list[Snapshot]:
    """Return the start, the snapshots nearest to a twelfth and a quarter of the time, and the end."""
    end = snapshots[-1].time
    chosen = [
        min(snapshots, key=lambda snapshot: abs(snapshot.time - share * end)) for share in (0.0, 1 / 12, 0.25, 1.0)
    ]
    return list(dict.fromkeys(chosen))
