"""``capsbayes measure``: lengths of the capsule in a picture or a contour, or of those in a film or an .rtdc file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import capsbayes as cb
from capsbayes.cli.command import Input, Option, Reads, Writes, command, wants_json
from capsbayes.cli.options import BY_HAND, PictureOptions, PicturesOptions
from capsbayes.cli.output import conclude, table_file, tell
from capsbayes.errors import InputError
from capsbayes.files.output_file import together
from capsbayes.files.recording import PICTURE_KINDS, is_film, kind_of, unknown

if TYPE_CHECKING:
    import pandas as pd

    from capsbayes.image.detect import Detection
    from capsbayes.image.film import FilmMeasurement

DETECTED = ("overlay.png", "outline.csv", "silhouette.csv", "measurement.toml", "measurement.outline.csv")
"""Files that `capsbayes.image.measure.write_detection` writes."""

_CONTOURS = (".csv", ".txt", ".roi", ".json")  # as `capsbayes.image.contour` reads, which is slow to import
_SPEEDS = ("--velocity", "--flow-rate")
_OF_CONTOUR = ("--walls", "--wall-error", "--pixel-size", "--edge-error", "--contour-unit", "--contour-points")
# which of the options a kind of input takes, in addition to --experiment and --out
_TAKES = {
    "picture": (*_SPEEDS, "--flow", "--background", *BY_HAND),
    "target": ("--target", "--pixel-size", "--crop", "--contrast", "--gamma"),
    "film": ("--frame-rate", "--flow", "--background", *(option for option in BY_HAND if option != "--erase")),
    "contour": (*_SPEEDS, "--flow", *_OF_CONTOUR),
    ".rtdc file": ("--flow-rate", "--flow", "--shared-velocity", "--pixel-size", "--axis"),
}
_EVENTS = "the events of a file"
_PART = 200  # events that are measured and written as one step
_RATES = 0.01  # relative difference of the flow rate between file and option above which the user is told
_POWERS = {2: "squared", 3: "cubed"}


@dataclass(frozen=True)
class StatedOptions(PicturesOptions):
    """What is stated of a picture, a film, a contour or an .rtdc file."""

    frame_rate: Annotated[str | None, Option('Of a film, as "2000 Hz"; default: frame_rate of the experiment.')] = None
    target: Annotated[
        str | None,
        Option(
            'Diameter of a bead or disc in place of the capsule, as "20.0 +/- 0.1 um", with --pixel-size: it tells '
            "--edge-offset for pictures with the same optics."
        ),
    ] = None
    edge_error: Annotated[
        str | None, Option('How well either end of a contour lies on the edge, as "0.10 um"; default: 1 px.')
    ] = None
    contour_unit: Annotated[str | None, Option("px or um, where a contour's columns do not say.")] = None
    contour_points: Annotated[
        str | None, Option("Of a contour of whole pixels: through their centres, or along their borders.")
    ] = None


def _written(values: Mapping[str, Any]) -> tuple[str, ...]:
    of_kind = {
        "film": ("capsules.csv", *(f"capsule-*/{name}" for name in (*DETECTED, "frames.csv"))),
        ".rtdc file": ("events.csv", *(f"event-*/{name}" for name in DETECTED)),
        "contour": DETECTED[-2:],
    }
    return of_kind.get(_kind(values["picture"]), DETECTED)


@command
def measure(
    picture: Annotated[
        Path,
        Input(
            "PNG, TIFF, JPEG or BMP of one capsule between the two walls; a film: AVI, MP4, TIFF of several pages, or "
            "a folder of pictures; a contour: CSV or text of points, ImageJ .roi, LabelMe .json; or an .rtdc file."
        ),
    ],
    experiment: Annotated[Path, Reads("TOML file of the experiment.")],
    stated: StatedOptions,
    out: Annotated[
        Path | None,
        Writes("Folder for measurement.toml with its silhouette, outline.csv and overlay.png.", within=_written),
    ] = None,
) -> None:
    """Measure the capsule in a picture, or all capsules in a film: lengths with their errors."""
    from capsbayes.run import resumable

    kind = _kind(picture) if stated.target is None else "target"
    if kind == ".rtdc file" and stated.velocity is not None:
        stated.speeds(None, several=_EVENTS)  # refuses it with advice
    for option, value in stated.given().items():
        if option not in _TAKES[kind]:
            raise InputError("measure", option, f"one of {', '.join(_TAKES[kind])} for a {kind}", str(value))
    kinds: dict[str, Any] = {"film": _measure_film, ".rtdc file": _measure_rtdc, "contour": _measure_contour}
    kinds |= {"picture": partial(measured_picture, record=True), "target": _measure_target}
    known = cb.Experiment.read(experiment)
    with resumable(out):
        kinds[kind](picture, known, stated, out)


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in _CONTOURS:
        return "contour"
    if suffix == ".rtdc":
        kind_of(path)  # refuses what its first bytes deny
        return ".rtdc file"
    if path.is_file() and not kind_of(path) and not is_picture(path):
        raise unknown(str(path))
    return "film" if is_film(path) else "picture"


def is_picture(path: Path) -> bool:
    """Return True for the name of a picture, or its first bytes."""
    from capsbayes.files.input_file import PICTURES

    return path.suffix.lower() in PICTURES or kind_of(path) in PICTURE_KINDS


def measured_picture(
    path: Path, experiment: cb.Experiment, stated: PictureOptions, out: Path | None, *, record: bool = False
) -> cb.Measurement:
    """Measure the capsule in a picture, write and print what was detected; as JSON only its `record`; failures end."""
    from capsbayes.image.measure import detected_in, measurement_of, write_detection

    speeds = stated.speeds(experiment)
    seen, detection = detected_in(path, stated.background, stated.flow, stated.by_hand(), experiment)
    measured = measurement_of(detection, seen, experiment, speeds.get("capsule_velocity"), speeds.get("flow_rate"))
    if out is not None:
        write_detection(out, seen, detection, measured, experiment)
    if record or not wants_json.get():
        parts = _detection_parts(detection, measured, experiment) if measured.status.ok else ()
        conclude(_record(measured), parts, lines=[f"Status: {measured.status}"], good=measured.status.ok)
    elif not measured.status.ok:
        typer.echo(f"Status: {measured.status}", err=True)
        raise typer.Exit(1)
    return measured


def _measure_target(path: Path, experiment: cb.Experiment, stated: StatedOptions, out: Path | None) -> None:
    from capsbayes.image import Picture, edge_offset_of

    if out is not None:
        raise InputError("measure", "--out", "none for a target", str(out))
    if stated.target is None or stated.pixel_size is None:
        raise InputError("measure", "--target", "--pixel-size with it", "none")
    found = edge_offset_of(Picture.read(path), stated.target, stated.pixel_size, by_hand=stated.by_hand())
    side = "outside" if found.value > 0.0 else "inside"
    tell(
        {"edge_offset": {"value": found.value, "error": found.error}},
        f"The true edge lies {abs(found.value):.2f} px {side} the located one.",
        f'For pictures with the same optics: --edge-offset "{found.value:.2f} +/- {found.error:.2f} px"',
    )


def _record(measured: cb.Measurement) -> dict[str, object]:
    """Return a measurement ready for JSON: lengths over l, velocity in SI, each with its standard error."""
    record: dict[str, object] = {"status": measured.status.name, "sentence": str(measured.status)}
    if not measured.status.ok:
        return record
    for name in ("axial_extent", "axial_length", "capsule_velocity", "flow_rate"):
        if getattr(measured, name) is not None:
            record[name] = {"value": getattr(measured, name), "error": getattr(measured, f"{name}_error")}
    points = 0 if measured.outline is None else len(measured.outline.points)
    further = {name: getattr(measured, name) for name in ("length_correlation", "axial_length_bound")}
    return record | {**further, "points_of_outline": points}


def _detection_parts(detection: Detection, measured: cb.Measurement, experiment: cb.Experiment) -> Iterator[Any]:
    """Yield what is printed of a capsule that was detected."""
    from capsbayes.report.tables import table

    yield table(("", "px", "over l", "µm"), _length_rows(detection, experiment), numbers=(1, 2, 3))
    rear, bound = detection.rear, measured.axial_length_bound
    if rear is None or bound is not None:
        why = "not seen" if rear is None else "too uncertain"
        yield f"The concave rear is {why}: L_a is at most {bound:.4f} l, the length of the silhouette."
    else:
        where = "; where in the band the membrane lies is not in the error."
        if rear.within > 0.0:
            where = f": the membrane lies anywhere within, and {rear.within:.1f} px of that are in the error of L_a."
        yield f"L_a goes to the middle of the rear band, whose standard deviation is {rear.width:.1f} px{where}"
    if detection.walls is not None and detection.walls.stated:
        yield f"l in px is that of {detection.walls.stated}."
    yield measured.doubt
    if detection.shift > 0.0:
        yield (
            "The noise shows that the picture was smoothed, by a filter or a compression: that adds "
            f"{detection.shift:.2f} px to the errors of all edges."
        )
    if detection.line > 0.0:
        yield (
            f"The membrane is seen as a line. The edge is taken {detection.inwards:.1f} px within its outer side; that "
            "it may lie elsewhere in the line is in the errors, unless it is stated from the middle (--edge-offset)."
        )
    if experiment.camera is not None:
        words = "are taken out of L_z, L_a and L_p; perimeter, area, volume and Lambda are as seen."
        yield f"The faults of the camera ({experiment.camera.described()}) {words}"
    yield _outline_words(measured)


def _length_rows(detection: Detection, experiment: cb.Experiment) -> Iterator[tuple[str, ...]]:
    """Yield each length in px, over l and in um."""
    half_width, half_width_error = 1e6 * experiment.half_width.mean, 1e6 * experiment.half_width.sd
    for name, power, value, error, ratio, ratio_error in detection.table().itertuples():
        if not math.isfinite(value):
            yield name, "not seen", "", ""
        elif name == "l":
            yield name, _pair(value, error), "1", _pair(half_width, half_width_error)
        elif name in ("L_z", "L_a", "L_p"):
            real = math.hypot(half_width * ratio_error, ratio * half_width_error)
            yield name, _pair(value, error), _pair(ratio, ratio_error, digits=4), _pair(ratio * half_width, real)
        else:
            words = f"{name} ({_POWERS[power]})" if power in _POWERS else name
            yield words, _significant(value, error), _significant(ratio, ratio_error), ""


def _outline_words(measured: cb.Measurement) -> str:
    """Return the errors of the silhouette of a measurement, or why there is none."""
    if measured.outline is None:
        return "The shape does not show which end is the front: no silhouette is kept. Give --flow."
    noise, pose = measured.outline.noise, measured.outline.pose
    return (
        f"Silhouette: {len(measured.outline.points)} points, each with a standard error of {noise.scale:.4f} l; "
        f"{1.0 - noise.white:.0%} of the variance is correlated over {noise.correlation_length:.2f} l of the edge, "
        f"and all have a common offset of about {pose.offset:.4f} l."
    )


def _significant(value: float, error: float) -> str:
    return _pair(value, error, digits=max(0, 1 - math.floor(math.log10(error))))


def _pair(value: float, error: float, *, digits: int = 2) -> str:
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def _measure_contour(path: Path, experiment: cb.Experiment, stated: StatedOptions, out: Path | None) -> None:
    from capsbayes.image.contour import ContourFile, measure_contour

    speeds, by_hand = stated.speeds(experiment), stated.by_hand()
    contour = ContourFile.read(path, stated.contour_unit)
    if stated.flow is None:
        raise InputError("measure", "--flow", "right or left", "nothing", "a contour does not say")
    how: dict[str, Any] = {name: speeds.get(name) for name in ("capsule_velocity", "flow_rate")}
    if stated.edge_error is not None:
        text, key = stated.edge_error, "--edge-error"
        how["edge_error"] = cb.Quantity.read(text, where="measure", key=key, units=("m",), example="0.10 um")
    if by_hand is not None:
        how |= {name: getattr(by_hand, name) for name in ("walls", "wall_error", "pixel_size")}
    measured = measure_contour(contour, experiment, flow=stated.flow, points=stated.contour_points, **how)
    if out is not None:
        measured.write(out / "measurement.toml")
    length = "The contour has no concave rear: L_a is at most its length."
    if measured.axial_length is not None and measured.axial_length_error is not None:
        length = f"L_a {_pair(measured.axial_length, measured.axial_length_error, digits=4)} l"
    extent = f"L_z {_pair(measured.axial_extent, measured.axial_extent_error, digits=4)} l"
    parts = [extent, length, _outline_words(measured)] if measured.status.ok else ()
    conclude(_record(measured), parts, lines=[f"Status: {measured.status}"], good=measured.status.ok)


def _measure_film(path: Path, experiment: cb.Experiment, stated: StatedOptions, out: Path | None) -> None:
    """Measure the capsules of a film, print them, and write the files of each."""
    from capsbayes.image.files import Film
    from capsbayes.run import progress_bar

    rate = experiment.frame_rate
    if stated.frame_rate is not None:
        rate = cb.Quantity.read(stated.frame_rate, where="--frame-rate", key="", units=("1/s",), example="2000 Hz")
    if rate is None:
        advice = "give --frame-rate, or frame_rate in the experiment's file; that of a video is the one it is shown at"
        raise InputError("measure", "--frame-rate", "the rate at which the film was taken", "nothing", advice)
    how: dict[str, Any] = {"flow": stated.flow, "by_hand": stated.by_hand(), "background": stated.background}
    film = Film.open(path)
    with progress_bar(film.count, "frames") as update:
        made = cb.measure_film(film, experiment, frame_rate=rate, watch=update, **how)
    table = made.table()
    if out is not None:
        _write_film(made, table, out, experiment)
    good = sum(capsule.status.ok for capsule in made.capsules)
    parts, words, rows = [], str(made.status), []
    if made.status.ok:
        parts, words = _film_parts(made, table), f"{good} of {len(made.capsules)} capsules measured."
        rows = json.loads(table.to_json(orient="records"))
    record = {"status": made.status.name, "frames": made.frames, "capsules": rows}
    conclude(record, parts, lines=[f"Status: {words}"], good=good > 0)


def _film_parts(made: FilmMeasurement, capsules: pd.DataFrame) -> list[Any]:
    """Return what is printed of the capsules of a film."""
    from capsbayes.report.tables import table

    head = ("", "frames", "L_z over l", "L_a over l", "v_o mm/s", "")
    rows, changes = [], []
    for _, row in capsules.iterrows():
        frames = str(row["frames"]) if row["alike"] == row["frames"] else f"{row['alike']} of {row['frames']}"
        rows.append((str(row["capsule"]), frames, *_cells(row), row["status"]))
        pairs = [(row[f"{name}_change"], row[f"{name}_change_error"]) for name in ("L_z", "L_a", "v_o")]
        sigmas = (f"{100.0 * by:+.2f} % ({abs(by) / error:.1f})" if error > 0.0 else "" for by, error in pairs)
        changes.append((str(row["capsule"]), *sigmas))
    title = "Change along the channel (in standard errors)"
    changed = table(("", "L_z", "L_a", "v_o"), changes, title=title, numbers=(1, 2, 3))
    clipped = f", {made.saturated} clipped between the walls" if made.saturated else ""
    unread = f", {made.unreadable} that could not be read" if made.unreadable else ""
    refused = [f"{status.name} {count}" for status, count in (made.statuses or {}).items() if not status.ok]
    counts = f"{made.frames} frames{unread}{clipped}. Objects refused: {', '.join(refused) or 'none'}."
    doubts = {capsule.measurement.doubt: None for capsule in made.capsules}
    return [table(head, rows), changed, counts, *doubts]


def _cells(row: pd.Series) -> list[str]:
    """Return the lengths and the velocity of one capsule as text."""
    lengths = [
        _pair(row[f"{name}_over_l"], row[f"{name}_error_over_l"], digits=4) if row[f"{name}_over_l"] > 0.0 else ""
        for name in ("axial_extent", "axial_length")
    ]
    if row["axial_length_bound_over_l"] > 0.0:
        lengths[1] = f"at most {row['axial_length_bound_over_l']:.4f}"
    speed, error = 1e3 * row["velocity_m_s"], 1e3 * row["velocity_error_m_s"]
    return [*lengths, _significant(speed, error) if error > 0.0 else ""]


@together()
def _write_film(made: FilmMeasurement, table: pd.DataFrame, out: Path, known: cb.Experiment) -> None:
    """Write capsules.csv and a folder for each capsule: all of it or nothing."""
    from capsbayes.image.measure import write_detection

    table_file(table, index=False)(out / "capsules.csv")
    for number, capsule in enumerate(made.capsules, start=1):
        shown = capsule.record
        if shown.picture is None or shown.detection is None:
            continue
        folder = out / f"capsule-{number}"
        write_detection(folder, shown.picture, shown.detection, capsule.measurement, known)
        table_file(capsule.table(), index=False, float_format="%.4f")(folder / "frames.csv")


def _measure_rtdc(path: Path, experiment: cb.Experiment, stated: StatedOptions, out: Path | None) -> None:
    """Measure the events of a file, count their statuses, and write the files of each."""
    import pandas as pd

    from capsbayes.image.measure import write_detection
    from capsbayes.image.rtdc import RtdcFile, measure_rtdc
    from capsbayes.run import progress_bar, step_of

    speeds, by_hand = stated.speeds(experiment, several=_EVENTS), stated.by_hand()
    if by_hand is None or by_hand.pixel_size is None:
        raise InputError("measure", "--pixel-size", 'one with an error, as "0.340 +/- 0.003 um"', "nothing")
    file = RtdcFile.open(path)
    how: dict[str, Any] = {"shared_velocity": speeds.get("capsule_velocity"), "flow_rate": speeds.get("flow_rate")}
    how |= {"pixel_size": by_hand.pixel_size, "axis": by_hand.axis, "flow": stated.flow}
    rate = speeds.get("flow_rate")
    if rate is not None and file.flow_rate is not None and abs(rate.value / file.flow_rate - 1.0) > _RATES:
        inside, given = f"{1e9 * file.flow_rate:.4g}", f"{1e9 * rate.value:.4g}"
        typer.echo(f"The file states a flow rate of {inside} uL/s; the {given} uL/s of --flow-rate are used.", err=True)

    def measured(events: range) -> list[dict[str, object]]:
        rows = []
        for event in measure_rtdc(file, experiment, events=events, **how):
            rows.append(event.row())
            if out is not None:
                seen = event.picture, event.detection, event.measurement
                write_detection(out / f"event-{event.number}", *seen, experiment)
        return rows

    rows: list[dict[str, object]] = []
    with progress_bar(file.events, "events") as update:
        for start in range(0, file.events, _PART):
            events = range(start, min(start + _PART, file.events))
            key = "events", file.sha256, experiment, dict(speeds), by_hand, stated.flow, events
            rows += step_of(list, key, partial(measured, events))
            update(events.stop)
    table = pd.DataFrame(rows)
    if out is not None:
        table_file(table, index=False)(out / "events.csv")
    counts = table["status"].value_counts()
    tell(
        {"statuses": counts.to_dict(), "events": json.loads(table.to_json(orient="records"))},
        ", ".join(f"{name} {count}" for name, count in counts.items()),
        f"Status: {counts.get('DONE', 0)} of {file.events} events measured.",
        good="DONE" in counts,
    )
