"""``capsbayes measure`` of an .rtdc file: a table of its events, and a folder for each that was measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.quantity import Quantity


def measure_rtdc(
    path: Path,
    experiment: Experiment,
    *,
    velocity: Quantity,
    pixel_size: Quantity,
    flow: str | None,
    out: Path | None,
) -> None:
    """Measure the events of a file, count their statuses, and write the files of each."""
    import pandas as pd

    from capsbayes.cli.measure_picture import write_detection
    from capsbayes.image.files.rtdc import RtdcFile
    from capsbayes.image.measure_rtdc import measure_rtdc
    from capsbayes.work.progress import tracked

    file = RtdcFile.open(path)
    events = measure_rtdc(file, experiment, capsule_velocity=velocity, pixel_size=pixel_size, flow=flow)
    rows = []
    for event in tracked(events, file.events, "events"):
        rows.append(event.row())
        if out is not None:
            write_detection(out / f"event-{event.number}", event.picture, event.detection, event.measurement)
    table = pd.DataFrame(rows)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        table.to_csv(out / "events.csv", index=False)
    counts = table["status"].value_counts()
    typer.echo(", ".join(f"{name} {count}" for name, count in counts.items()))
    typer.echo(f"Status: {counts.get('DONE', 0)} of {file.events} events measured.")
    if "DONE" not in counts:
        raise typer.Exit(1)
