"""``capsbayes measure``: from a picture to the lengths of the capsule in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.image.frames import Picture
    from capsbayes.image.sighting import Sighting
    from capsbayes.measurement import Measurement
    from capsbayes.quantity import Quantity

_KINDS = {True: "film", False: "picture"}


def measure(
    picture: Annotated[
        Path,
        typer.Argument(
            help="PNG, TIFF or JPEG of one capsule between the two walls; or a film: AVI, MP4, TIFF of several pages, "
            "or a folder of pictures."
        ),
    ],
    experiment: Annotated[Path, typer.Option(help="TOML file of the experiment.")],
    velocity: Annotated[
        str | None, typer.Option(help='Velocity of the capsule, as "6.20 +/- 0.06 mm/s"; a film shows it.')
    ] = None,
    frame_rate: Annotated[
        str | None, typer.Option(help='Of a film, as "2000 Hz"; default: frame_rate of the experiment.')
    ] = None,
    background: Annotated[Path | None, typer.Option(help="Picture of the empty channel.")] = None,
    flow: Annotated[str | None, typer.Option(help="right or left; default: as the shape tells.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for measurement.toml, outline.csv and overlay.png.")] = None,
) -> None:
    """Measure the capsule in a picture, or all those in a film: lengths with their errors."""
    from capsbayes.cli.measure_film import measure_film
    from capsbayes.errors import InputError
    from capsbayes.experiment import Experiment
    from capsbayes.image.film import is_film
    from capsbayes.image.frames import Picture
    from capsbayes.image.measure import measurement_of, sight

    if out is not None and out.exists() and not out.is_dir():
        raise InputError("--out", "", "a folder", f"the file {out}")
    known = Experiment.read(experiment)
    film = is_film(picture)
    for option, given, wanted in (("--velocity", velocity, not film), ("--frame-rate", frame_rate, film)):
        if given is not None and not wanted:
            raise InputError("measure", option, "it not to be given", given, f"leave it out for a {_KINDS[film]}")
    if film:
        measure_film(picture, known, frame_rate=frame_rate, background=background, flow=flow, out=out)
        return
    speed = _speed(velocity)
    seen = Picture.read(picture)
    sighting = sight(seen, background=None if background is None else Picture.read(background), flow=flow)
    measured = measurement_of(sighting, seen, known, speed)
    if sighting.status.ok:
        _print(sighting, known)
    if out is not None:
        write_sighting(out, seen, sighting, measured)
    typer.echo(f"Status: {measured.status}")
    if not measured.status.ok:
        raise typer.Exit(1)


def _speed(text: str | None) -> Quantity:
    from capsbayes.errors import InputError
    from capsbayes.quantity import quantity

    example = "6.20 +/- 0.06 mm/s"
    if text is None:
        raise InputError("measure", "--velocity", f'a text like "{example}"', "nothing", "one picture does not show it")
    speed = quantity(text, where="--velocity", key="", units=("m/s",), example=example)
    if speed.error == 0.0:
        raise InputError("--velocity", "", f'a standard error, as in "{example}"', repr(text))
    return speed


def _print(sighting: Sighting, experiment: Experiment) -> None:
    import numpy as np
    from rich import box
    from rich.console import Console
    from rich.table import Table

    width = experiment.half_width
    micrometres = 1e6 * float(width.mean() if hasattr(width, "mean") else width)
    spread = float(width.std() / width.mean()) if hasattr(width, "mean") else 0.0
    lengths, errors = sighting.lengths, np.sqrt(np.diag(sighting.covariance))
    l_px, l_error = lengths[3], errors[3]
    table = Table("", "px", "over l", "um", box=box.SIMPLE_HEAD)
    for name, length, error in zip(("L_z", "L_a", "L_p"), lengths, errors, strict=False):
        if not np.isfinite(length):
            table.add_row(name, "not seen", "", "")
            continue
        ratio = length / l_px
        ratio_error = np.hypot(error, ratio * l_error) / l_px
        shown = (length, error), (ratio, ratio_error), (ratio * micrometres, 0.0)
        real = micrometres * np.hypot(ratio_error, ratio * spread)
        table.add_row(name, _pair(*shown[0]), _pair(*shown[1], digits=4), _pair(shown[2][0], real))
    table.add_row("l", _pair(l_px, l_error), "1", f"{micrometres:.2f} +/- {spread * micrometres:.2f}")
    console = Console(highlight=False)
    console.print(table)
    if sighting.rear is None:
        bound = (lengths[0] + 2.0 * errors[0]) / l_px
        console.print(f"The concave rear is not seen: L_a is at most {bound:.4f} l, the length of the silhouette.")
    else:
        console.print(
            f"L_a goes to the middle of the rear band, whose standard deviation is {sighting.rear.width:.1f} px; "
            "where in the band the membrane lies is not in the error."
        )


def _pair(value: float, error: float, *, digits: int = 2) -> str:
    return f"{value:.{digits}f} +/- {error:.{digits}f}"


def write_sighting(out: Path, picture: Picture, sighting: Sighting, measured: Measurement) -> None:
    """Write what there is: of a capsule that could not be measured, the picture with what was found in it."""
    import numpy as np

    from capsbayes.image.overlay import write_overlay

    out.mkdir(parents=True, exist_ok=True)
    write_overlay(out / "overlay.png", picture, sighting)
    if sighting.outline is not None:
        one = sighting.outline
        error = np.hypot(one.point_error, one.arc_error)
        columns = np.column_stack([one.points, one.normals, error, one.edge_width])
        header = "x_px,y_px,normal_x,normal_y,error_px,edge_width_px"
        np.savetxt(out / "outline.csv", columns, fmt="%.4f", delimiter=",", header=header, comments="")
    if measured.status.ok:
        measured.write(out / "measurement.toml")
