"""``capsbayes measure`` of a picture: print and write what was detected; `identify` begins with it too."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from capsbayes.cli.output import print_json

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.image import ByHand
    from capsbayes.image.detect import Detection
    from capsbayes.image.edges import RearBand
    from capsbayes.measurement import Measurement
    from capsbayes.quantity import Quantity

DETECTED = ("overlay.png", "outline.csv", "silhouette.csv", "measurement.toml", "measurement.outline.csv")
"""Files that `capsbayes.image.measure.write_detection` writes."""

_POWERS = {2: "squared", 3: "cubed"}


def is_picture(path: Path) -> bool:
    """Return True for the name of a picture, or its first bytes."""
    from capsbayes.files.input_file import PICTURES
    from capsbayes.files.recording import PICTURE_KINDS, kind_of

    return path.suffix.lower() in PICTURES or kind_of(path) in PICTURE_KINDS


def measured_picture(
    path: Path,
    experiment: Experiment,
    speeds: Mapping[str, Quantity],
    background: Path | None,
    flow: str | None,
    out: Path | None,
    *,
    by_hand: ByHand | None = None,
    quiet: bool = False,
    as_json: bool = False,
) -> Measurement:
    """Measure the capsule in a picture, print and write what was detected; end the command on a failure.

    Parameters
    ----------
    path : Path
    experiment : Experiment
    speeds : mapping of Quantity
        ``capsule_velocity`` [m/s] or ``flow_rate`` [m^3/s] with its standard error, or both; neither where the
        experiment states the viscous tension.
    background : Path, optional
        Picture of the empty channel.
    flow : str, optional
        ``"right"`` or ``"left"``.
    out : Path, optional
        Folder.
    by_hand : ByHand, optional
        What is stated of the picture.
    quiet : bool
        True to print only the reason of a failure.
    as_json : bool
        True to print the measurement as JSON.
    """
    from capsbayes.image.files import Picture
    from capsbayes.image.measure import detect, measurement_of, turned, write_detection
    from capsbayes.report.tables import print_parts

    quiet |= as_json
    empty = None if background is None else Picture.read(background)
    seen, empty, by_hand = turned(Picture.read(path), empty, by_hand)
    detection = detect(seen, background=empty, flow=flow, by_hand=by_hand, half_width=experiment.half_width)
    measured = measurement_of(detection, seen, experiment, speeds.get("capsule_velocity"), speeds.get("flow_rate"))
    if detection.status.ok and not quiet:
        _print(detection, experiment)
        if experiment.camera is not None:
            lengths = ", ".join(f"{length:.4f}" for length in measured.lengths)
            print_parts(f"Over l without the faults of the camera ({experiment.camera.described()}): {lengths}.")
        print_outline(measured)
    if out is not None:
        write_detection(out, seen, detection, measured)
    if as_json:
        print_json(as_record(measured))
    elif not (quiet and measured.status.ok):
        typer.echo(f"Status: {measured.status}", err=quiet)
    if not measured.status.ok:
        raise typer.Exit(1)
    return measured


def as_record(measured: Measurement) -> dict[str, object]:
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


def print_outline(measured: Measurement) -> None:
    """Print the errors of the silhouette of a measurement, or why there is none."""
    from capsbayes.report.tables import print_parts

    if measured.outline is None:
        print_parts("The shape does not show which end is the front: no silhouette is kept. Give --flow.")
        return
    noise, pose = measured.outline.noise, measured.outline.pose
    print_parts(
        f"Silhouette: {len(measured.outline.points)} points, each with a standard error of {noise.scale:.4f} l; "
        f"{1.0 - noise.white:.0%} of the variance is correlated over {noise.correlation_length:.2f} l of the edge, "
        f"and all have a common offset of about {pose.offset:.4f} l."
    )


def _print(detection: Detection, experiment: Experiment) -> None:
    import numpy as np

    from capsbayes.report.tables import print_parts, table

    half_width, half_width_error = 1e6 * experiment.half_width.mean, 1e6 * experiment.half_width.sd
    rows: list[tuple[str, ...]] = []
    for name, power, value, error, ratio, ratio_error in detection.table().itertuples():
        if not np.isfinite(value):
            rows.append((name, "not seen", "", ""))
        elif name == "l":
            rows.append((name, pair(value, error), "1", pair(half_width, half_width_error)))
        elif name in ("L_z", "L_a", "L_p"):
            real = np.hypot(half_width * ratio_error, ratio * half_width_error)
            lengths = pair(ratio, ratio_error, digits=4), pair(ratio * half_width, real)
            rows.append((name, pair(value, error), *lengths))
        else:
            words = f"{name} ({_POWERS[power]})" if power in _POWERS else name
            rows.append((words, _significant(value, error), _significant(ratio, ratio_error), ""))
    if detection.rear is None:
        bound = (detection.lengths[0] + 2.0 * np.sqrt(detection.covariance[0, 0])) / detection.lengths[3]
        rear = f"The concave rear is not seen: L_a is at most {bound:.4f} l, the length of the silhouette."
    else:
        rear = _of_band(detection.rear)
    parts: list[Any] = [table(("", "px", "over l", "µm"), rows, numbers=(1, 2, 3)), rear]
    if detection.walls is not None and detection.walls.stated:
        parts.append(f"l in px is that of {detection.walls.stated}.")
        parts.append(detection.walls.doubt)
    if detection.shift > 0.0:
        parts.append(
            "The noise shows that the picture was smoothed, by a filter or a compression: that adds "
            f"{detection.shift:.2f} px to the errors of all edges."
        )
    print_parts(*parts)


def _of_band(rear: RearBand) -> str:
    ends = f"L_a goes to the middle of the rear band, whose standard deviation is {rear.width:.1f} px"
    if rear.within > 0.0:
        return f"{ends}: the membrane lies anywhere within, and {rear.within:.1f} px of that are in the error of L_a."
    return f"{ends}; where in the band the membrane lies is not in the error."


def _significant(value: float, error: float) -> str:
    import math

    return pair(value, error, digits=max(0, 1 - math.floor(math.log10(error))))


def pair(value: float, error: float, *, digits: int = 2) -> str:
    """Return a value with its standard error, as text."""
    return f"{value:.{digits}f} ± {error:.{digits}f}"
