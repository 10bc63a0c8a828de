"""``capsbayes measure`` of a film or an .rtdc file: a table of its capsules or events, and a folder for each."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from capsbayes.cli.output import print_json, table_file
from capsbayes.errors import InputError
from capsbayes.files.output_file import together

if TYPE_CHECKING:
    import pandas as pd

    from capsbayes.experiment import Experiment
    from capsbayes.image import ByHand
    from capsbayes.image.film import FilmMeasurement
    from capsbayes.quantity import Quantity

_PART = 200  # events that are measured and written as one step
_RATES = 0.01  # largest relative difference of the flow rate between file and option that is not told


def measure_film(
    path: Path,
    experiment: Experiment,
    *,
    frame_rate: str | None,
    background: Path | None,
    flow: str | None,
    by_hand: ByHand | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Measure the capsules of a film, print them, and write the files of each."""
    from capsbayes.image.files import Film
    from capsbayes.image.film import measure_film
    from capsbayes.run import progress_bar

    rate = _rate(frame_rate, experiment)
    film = Film.open(path)
    with progress_bar(film.count, "frames") as update:
        made = measure_film(
            film, experiment, frame_rate=rate, background=background, flow=flow, by_hand=by_hand, watch=update
        )
    table = made.table()
    if made.status.ok and not as_json:
        _print(made, table)
    if out is not None:
        _write(made, table, out)
    good = sum(capsule.status.ok for capsule in made.capsules)
    if as_json:
        rows = json.loads(table.to_json(orient="records")) if made.status.ok else []
        print_json({"status": made.status.name, "frames": made.frames, "capsules": rows})
    else:
        words = f"{good} of {len(made.capsules)} capsules measured." if made.status.ok else str(made.status)
        typer.echo(f"Status: {words}")
    if not good:
        raise typer.Exit(1)


def measure_rtdc(
    path: Path,
    experiment: Experiment,
    speeds: Mapping[str, Quantity],
    *,
    flow: str | None,
    by_hand: ByHand | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Measure the events of a file, count their statuses, and write the files of each."""
    import pandas as pd

    from capsbayes.image.measure import write_detection
    from capsbayes.image.rtdc import RtdcFile, measure_rtdc
    from capsbayes.run import progress_bar, step_of

    if by_hand is None or by_hand.pixel_size is None:
        raise InputError("measure", "--pixel-size", 'one with an error, as "0.340 +/- 0.003 um"', "nothing")
    file, how = RtdcFile.open(path), {"pixel_size": by_hand.pixel_size, "axis": by_hand.axis, "flow": flow}
    rate = speeds.get("flow_rate")
    if rate is not None and file.flow_rate is not None and abs(rate.value / file.flow_rate - 1.0) > _RATES:
        stated, given = f"{1e9 * file.flow_rate:.4g}", f"{1e9 * rate.value:.4g}"
        typer.echo(f"The file states a flow rate of {stated} uL/s; the {given} uL/s of --flow-rate are used.", err=True)

    def measured(events: range) -> list[dict[str, object]]:
        rows = []
        velocity = speeds.get("capsule_velocity")
        for event in measure_rtdc(file, experiment, shared_velocity=velocity, flow_rate=rate, events=events, **how):
            rows.append(event.row())
            if out is not None:
                write_detection(out / f"event-{event.number}", event.picture, event.detection, event.measurement)
        return rows

    rows: list[dict[str, object]] = []
    with progress_bar(file.events, "events") as update:
        for start in range(0, file.events, _PART):
            events = range(start, min(start + _PART, file.events))
            key = "events", file.sha256, experiment, dict(speeds), by_hand, flow, events
            rows += step_of(list, key, partial(measured, events))
            update(events.stop)
    table = pd.DataFrame(rows)
    if out is not None:
        table_file(table, index=False)(out / "events.csv")
    counts = table["status"].value_counts()
    if as_json:
        print_json({"statuses": counts.to_dict(), "events": json.loads(table.to_json(orient="records"))})
    else:
        typer.echo(", ".join(f"{name} {count}" for name, count in counts.items()))
        typer.echo(f"Status: {counts.get('DONE', 0)} of {file.events} events measured.")
    if "DONE" not in counts:
        raise typer.Exit(1)


def _rate(text: str | None, experiment: Experiment) -> Quantity:
    from capsbayes.quantity import Quantity

    if text is not None:
        return Quantity.read(text, where="--frame-rate", key="", units=("1/s",), example="2000 Hz")
    if experiment.frame_rate is None:
        advice = "give --frame-rate, or frame_rate in the experiment's file; that of a video is the one it is shown at"
        raise InputError("measure", "--frame-rate", "the rate at which the film was taken", "nothing", advice)
    return experiment.frame_rate


def _print(made: FilmMeasurement, capsules: pd.DataFrame) -> None:
    from capsbayes.report.tables import print_parts, table

    head = ("", "frames", "L_z over l", "L_a over l", "v_o mm/s", "")
    rows, changes = [], []
    for _, row in capsules.iterrows():
        rows.append((str(row["capsule"]), _frames(row), *_cells(row), row["status"]))
        changes.append((str(row["capsule"]), *_changes(row)))
    title = "Change along the channel (in standard errors)"
    changed = table(("", "L_z", "L_a", "v_o"), changes, title=title, numbers=(1, 2, 3))
    clipped = f", {made.saturated} clipped between the walls" if made.saturated else ""
    unread = f", {made.unreadable} that could not be read" if made.unreadable else ""
    refused = [f"{status.name} {count}" for status, count in (made.statuses or {}).items() if not status.ok]
    counts = f"{made.frames} frames{unread}{clipped}. Objects refused: {', '.join(refused) or 'none'}."
    doubts = {capsule.measurement.doubt: None for capsule in made.capsules}
    print_parts(table(head, rows), changed, counts, *doubts)


def _frames(row: pd.Series) -> str:
    """Return in how many frames a capsule was measured, and how many of them count if not all do."""
    frames, alike = row["frames"], row["alike"]
    return str(frames) if alike == frames else f"{alike} of {frames}"


def _cells(row: pd.Series) -> list[str]:
    """Return the lengths and the velocity of one capsule as text."""
    lengths = [
        f"{row[f'{name}_over_l']:.4f} ± {row[f'{name}_error_over_l']:.4f}" if row[f"{name}_over_l"] > 0.0 else ""
        for name in ("axial_extent", "axial_length")
    ]
    if row["axial_length_bound_over_l"] > 0.0:
        lengths[1] = f"at most {row['axial_length_bound_over_l']:.4f}"
    speed, error = 1e3 * row["velocity_m_s"], 1e3 * row["velocity_error_m_s"]
    digits = max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 0
    return [*lengths, f"{speed:.{digits}f} ± {error:.{digits}f}" if error > 0.0 else ""]


def _changes(row: pd.Series) -> list[str]:
    """Return how lengths and velocity of one capsule change along the channel, as text."""
    pairs = [(row[f"{name}_change"], row[f"{name}_change_error"]) for name in ("L_z", "L_a", "v_o")]
    return [f"{100.0 * change:+.2f} % ({abs(change) / error:.1f})" if error > 0.0 else "" for change, error in pairs]


@together()
def _write(made: FilmMeasurement, table: pd.DataFrame, out: Path) -> None:
    """Write capsules.csv and a folder for each capsule: all of it or nothing."""
    from capsbayes.image.measure import write_detection

    table_file(table, index=False)(out / "capsules.csv")
    for number, capsule in enumerate(made.capsules, start=1):
        shown = capsule.record
        if shown.picture is None or shown.detection is None:
            continue
        folder = out / f"capsule-{number}"
        write_detection(folder, shown.picture, shown.detection, capsule.measurement)
        table_file(capsule.table(), index=False, float_format="%.4f")(folder / "frames.csv")
