"""``capsbayes measure`` of an .rtdc file: a table of its events, and a folder for each that was measured."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.image.measure_rtdc import Event
    from capsbayes.quantity import Quantity

_COLUMNS = (
    *("event", "status", "axial_extent_m", "axial_extent_error_m", "axial_length_m", "axial_length_error_m"),
    *("area_m2", "perimeter_m", "volume_m3"),
)


def measure_rtdc(
    path: Path,
    experiment: Experiment,
    *,
    velocity: Quantity,
    pixel_size: Quantity,
    flow: str | None,
    out: Path | None,
) -> None:
    """Measure the events of a file, count what came of them, and write what there is of each."""
    import sys
    from collections import Counter

    from rich.console import Console
    from rich.progress import track

    from capsbayes.image.measure_rtdc import measure_rtdc
    from capsbayes.image.rtdc import RtdcFile

    file = RtdcFile.open(path)
    events = measure_rtdc(file, experiment, capsule_velocity=velocity, pixel_size=pixel_size, flow=flow)
    shown = track(
        events,
        "events",
        total=file.events,
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    statuses: Counter[str] = Counter()
    rows = []
    for event in shown:
        statuses[event.sighting.status.name] += 1
        rows.append(_row(event, pixel_size.value))
        if out is not None:
            _write(event, out)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        with (out / "events.csv").open("w", newline="") as table:
            csv.writer(table).writerows([_COLUMNS, *rows])
    typer.echo(", ".join(f"{name} {count}" for name, count in statuses.most_common()))
    typer.echo(f"Status: {statuses['DONE']} of {file.events} events measured.")
    if not statuses["DONE"]:
        raise typer.Exit(1)


def _row(event: Event, pixel: float) -> list[object]:
    seen, inside = event.measurement, event.sighting.silhouette
    lengths = [seen.axial_extent, seen.axial_extent_error, seen.axial_length, seen.axial_length_error]
    row = [event.number, event.sighting.status.name, *(lengths if seen.status.ok else [None] * 4)]
    if not seen.status.ok or inside is None:
        return [*row, None, None, None]
    return [*row, inside.area.value * pixel**2, inside.perimeter.value * pixel, inside.volume.value * pixel**3]


def _write(event: Event, out: Path) -> None:
    from capsbayes.cli.measure_picture import write_sighting

    write_sighting(out / f"event-{event.number}", event.picture, event.sighting, event.measurement)
