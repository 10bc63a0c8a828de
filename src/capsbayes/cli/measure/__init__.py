"""``capsbayes measure``: lengths of the capsule in a picture, or of those in a film."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.measure.picture import DETECTED, as_record, is_picture, measured_picture, pair, print_outline
from capsbayes.cli.options import (
    BY_HAND,
    AsJson,
    Background,
    Flow,
    FlowRate,
    SharedVelocity,
    Velocity,
    by_hand_of,
    speeds_of,
    with_options_of,
)
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.image import ByHand
    from capsbayes.measurement import Measurement
    from capsbayes.quantity import Quantity

_CONTOURS = (".csv", ".txt", ".roi", ".json")  # as `capsbayes.image.contour` reads, which is slow to import
# which of the options a kind of input takes, in addition to --experiment, --flow and --out
_TAKES = {
    "picture": ("--velocity", "--flow-rate", "--background", *BY_HAND.values()),
    "film": ("--frame-rate", "--background", *(option for option in BY_HAND.values() if option != "--erase")),
    "contour": (
        "--velocity",
        "--flow-rate",
        "--walls",
        "--wall-error",
        "--pixel-size",
        "--edge-error",
        "--contour-unit",
        "--contour-points",
    ),
    ".rtdc file": ("--flow-rate", "--shared-velocity", "--pixel-size", "--axis"),
}


def _written(values: Mapping[str, Any]) -> tuple[str, ...]:
    of_kind = {
        "film": ("capsules.csv", *(f"capsule-*/{name}" for name in (*DETECTED, "frames.csv"))),
        ".rtdc file": ("events.csv", *(f"event-*/{name}" for name in DETECTED)),
        "contour": DETECTED[-2:],
    }
    return of_kind.get(_kind(values["picture"]), DETECTED)


@with_options_of(by_hand_of, "by_hand")
def measure(
    picture: Annotated[
        Path,
        typer.Argument(
            help="PNG, TIFF or JPEG of one capsule between the two walls; a film: AVI, MP4, TIFF of several pages, or "
            "a folder of pictures; a contour: CSV or text of points, ImageJ .roi, LabelMe .json; or an .rtdc file."
        ),
        Reads(),
    ],
    experiment: Annotated[Path, typer.Option(help="TOML file of the experiment."), Reads()],
    velocity: Velocity = None,
    flow_rate: FlowRate = None,
    shared_velocity: SharedVelocity = None,
    frame_rate: Annotated[
        str | None, typer.Option(help='Of a film, as "2000 Hz"; default: frame_rate of the experiment.')
    ] = None,
    background: Background = None,
    flow: Flow = None,
    by_hand: Any = None,
    edge_error: Annotated[
        str | None, typer.Option(help='How well either end of a contour lies on the edge, as "0.10 um"; default: 1 px.')
    ] = None,
    contour_unit: Annotated[str | None, typer.Option(help="px or um, where a contour's columns do not say.")] = None,
    contour_points: Annotated[
        str | None, typer.Option(help="Of a contour of whole pixels: through their centres, or along their borders.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for measurement.toml with its silhouette, outline.csv and overlay.png."),
        Writes(within=_written),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the capsule in a picture, or all capsules in a film: lengths with their errors."""
    from capsbayes.cli.measure.film import measure_film, measure_rtdc
    from capsbayes.experiment import Experiment
    from capsbayes.run import resumable

    kind = _kind(picture)
    speeds = {"--velocity": velocity, "--shared-velocity": shared_velocity, "--flow-rate": flow_rate}
    if kind == ".rtdc file" and velocity is not None:
        speeds_of(speeds, None, several="the events of a file")
    options = {
        **speeds,
        "--frame-rate": frame_rate,
        "--background": background,
        **{option: by_hand and getattr(by_hand, name) for name, option in BY_HAND.items()},
        "--edge-error": edge_error,
        "--contour-unit": contour_unit,
        "--contour-points": contour_points,
    }
    for option, given in options.items():
        if given is not None and option not in _TAKES[kind]:
            raise InputError("measure", option, f"one of {', '.join(_TAKES[kind])} for a {kind}", _typed(given))
    known = Experiment.read(experiment)
    with resumable(out):
        if kind == "film":
            how = {"frame_rate": frame_rate, "background": background, "flow": flow, "by_hand": by_hand}
            measure_film(picture, known, **how, out=out, as_json=as_json)
        elif kind == ".rtdc file":
            stated = speeds_of(speeds, known, several="the events of a file")
            measure_rtdc(picture, known, stated, flow=flow, by_hand=by_hand, out=out, as_json=as_json)
        elif kind == "contour":
            of_contour = edge_error, contour_unit, contour_points, flow
            measured = _measured_contour(picture, known, speeds_of(speeds, known), by_hand, *of_contour)
            if out is not None:
                measured.write(out / "measurement.toml")
            if as_json:
                print_json(as_record(measured))
            else:
                _print_contour(measured)
        else:
            found = speeds_of(speeds, known)
            measured_picture(picture, known, found, background, flow, out, by_hand=by_hand, as_json=as_json)


def _typed(given: object) -> str:
    return " ".join(map("{:g}".format, given)) if isinstance(given, tuple) else str(given)


def _kind(path: Path) -> str:
    from capsbayes.files.recording import is_film, kind_of, unknown

    suffix = path.suffix.lower()
    if suffix in _CONTOURS:
        return "contour"
    if suffix == ".rtdc":
        kind_of(path)  # refuses what its first bytes deny
        return ".rtdc file"
    if path.is_file() and not kind_of(path) and not is_picture(path):
        raise unknown(str(path))
    return "film" if is_film(path) else "picture"


def _measured_contour(
    path: Path,
    experiment: Experiment,
    speeds: Mapping[str, Quantity],
    by_hand: ByHand | None,
    edge_error: str | None,
    unit: str | None,
    points: str | None,
    flow: str | None,
) -> Measurement:
    from capsbayes.image.contour import ContourFile, measure_contour
    from capsbayes.quantity import Quantity

    contour = ContourFile.read(path, unit)
    if flow is None:
        raise InputError("measure", "--flow", "right or left", "nothing", "a contour does not say")
    edge = None
    if edge_error is not None:
        edge = Quantity.read(edge_error, where="measure", key="--edge-error", units=("m",), example="0.10 um")
    return measure_contour(
        contour,
        experiment,
        capsule_velocity=speeds.get("capsule_velocity"),
        flow_rate=speeds.get("flow_rate"),
        edge_error=edge,
        flow=flow,
        points=points,
        **({} if by_hand is None else {name: getattr(by_hand, name) for name in ("walls", "wall_error", "pixel_size")}),
    )


def _print_contour(measured: Measurement) -> None:
    typer.echo(f"L_z {pair(measured.axial_extent, measured.axial_extent_error, digits=4)} l")
    if measured.axial_length is None or measured.axial_length_error is None:
        typer.echo("The contour has no concave rear: L_a is at most its length.")
    else:
        typer.echo(f"L_a {pair(measured.axial_length, measured.axial_length_error, digits=4)} l")
    print_outline(measured)
    typer.echo(f"Status: {measured.status}")
