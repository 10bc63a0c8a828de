"""``capsbayes measure`` of a film: a table of its capsules, and a folder for each."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections import Counter

    from rich.table import Table

    from capsbayes.experiment import Experiment
    from capsbayes.image.filmed import FilmedCapsule
    from capsbayes.image.measure_film import FilmMeasurement
    from capsbayes.quantity import Quantity
    from capsbayes.status import Status

_COLUMNS = (
    *("capsule", "status", "frames", "axial_extent_over_l", "axial_extent_error_over_l"),
    *("axial_length_over_l", "axial_length_error_over_l", "velocity_m_s", "velocity_error_m_s"),
)


def measure_film(
    path: Path,
    experiment: Experiment,
    *,
    frame_rate: str | None,
    background: Path | None,
    flow: str | None,
    out: Path | None,
) -> None:
    """Measure the capsules of a film, print them, and write what there is of each."""
    rate = _rate(frame_rate, experiment)
    made = _measured(path, experiment, rate, background, flow)
    if made.status.ok:
        _print(made)
    if out is not None:
        _write(made, out)
    good = sum(capsule.status.ok for capsule in made.capsules)
    typer.echo(f"Status: {made.status if not made.status.ok else f'{good} of {len(made.capsules)} capsules measured.'}")
    if not good:
        raise typer.Exit(1)


def _rate(text: str | None, experiment: Experiment) -> Quantity:
    from capsbayes.errors import InputError
    from capsbayes.quantity import Quantity

    if text is not None:
        return Quantity.read(text, where="--frame-rate", key="", units=("1/s",), example="2000 Hz")
    if experiment.frame_rate is None:
        advice = "give --frame-rate, or frame_rate in the experiment's file; that of a video is the one it is shown at"
        raise InputError("measure", "--frame-rate", "the rate at which the film was taken", "nothing", advice)
    return experiment.frame_rate


def _measured(
    path: Path, experiment: Experiment, rate: Quantity, background: Path | None, flow: str | None
) -> FilmMeasurement:
    import sys

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from capsbayes.image.film import Film
    from capsbayes.image.measure_film import measure_film

    film = Film.open(path)
    layout = (BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeElapsedColumn())
    with Progress(*layout, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("frames", total=film.count)
        return measure_film(
            film,
            experiment,
            frame_rate=rate,
            background=background,
            flow=flow,
            watch=lambda done: bar.update(task, completed=done),
        )


def _print(made: FilmMeasurement) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("", "frames", "L_z over l", "L_a over l", "v_o mm/s", "change of L_z", "of L_a", "of v_o", ""):
        table.add_column(heading)
    for number, capsule in enumerate(made.capsules, start=1):
        _add_row(table, number, capsule)
    console = Console(highlight=False)
    console.print(table)
    clipped = f", {made.saturated} clipped between the walls" if made.saturated else ""
    unread = f", {made.unreadable} that could not be read" if made.unreadable else ""
    console.print(f"{made.frames} frames{unread}{clipped}. Spots refused: {_counted(made.statuses) or 'none'}.")


def _add_row(table: Table, number: int, capsule: FilmedCapsule) -> None:
    from capsbayes.image.motion import Drift

    def change(name: str) -> str:
        drift: Drift | None = capsule.drifts.get(name)
        return "" if drift is None else f"{100.0 * drift.change:+.2f} % ({drift.significance:.1f} s.e.)"

    seen = capsule.measurement
    cells = ["", "", ""]
    if capsule.status.ok:
        cells[0] = f"{seen.axial_extent:.4f} +/- {seen.axial_extent_error:.4f}"
        cells[1] = f"at most {seen.axial_length_bound:.4f}" if seen.axial_length_bound is not None else ""
        if seen.axial_length is not None:
            cells[1] = f"{seen.axial_length:.4f} +/- {seen.axial_length_error:.4f}"
        speed, error = 1e3 * seen.capsule_velocity, 1e3 * seen.capsule_velocity_error
        digits = max(0, 1 - math.floor(math.log10(error)))
        cells[2] = f"{speed:.{digits}f} +/- {error:.{digits}f}"
    changes = [change(name) for name in ("L_z", "L_a", "v_o")]
    table.add_row(str(number), str(len(capsule.moments)), *cells, *changes, capsule.status.name)


def _counted(statuses: Counter[Status] | None) -> str:
    return ", ".join(f"{one.name} {count}" for one, count in (statuses or {}).items() if not one.ok)


def _write(made: FilmMeasurement, out: Path) -> None:
    """Write capsules.csv and a folder for each capsule."""
    from capsbayes.cli.measure_picture import write_sighting

    out.mkdir(parents=True, exist_ok=True)
    with (out / "capsules.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(_COLUMNS)
        for number, capsule in enumerate(made.capsules, start=1):
            seen = capsule.measurement
            values = [seen.axial_extent, seen.axial_extent_error, seen.axial_length, seen.axial_length_error]
            values += [seen.capsule_velocity, seen.capsule_velocity_error]
            rows.writerow([number, capsule.status.name, len(capsule.moments), *values])
    for number, capsule in enumerate(made.capsules, start=1):
        if capsule.picture is None or capsule.sighting is None:
            continue
        folder = out / f"capsule-{number}"
        write_sighting(folder, capsule.picture, capsule.sighting, capsule.measurement)
        with (folder / "frames.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["frame", "along_px", "across_px", "axial_extent_px", "axial_length_px", "half_width_px"])
            for one in capsule.moments:
                rows.writerow([one.frame, *(f"{x:.4f}" for x in (*one.place, *one.lengths[[0, 1, 3]]))])
