"""``capsbayes measure``: from a picture to the lengths of the capsule in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.image.frames import Picture
    from capsbayes.image.integrals import Integral
    from capsbayes.image.sighting import Sighting
    from capsbayes.measurement import Measurement
    from capsbayes.quantity import Quantity

_POWERS = {2: "squared", 3: "cubed"}
_CONTOURS = (".csv", ".txt")
# which of the options a kind of input takes, besides --experiment, --flow and --out
_TAKES = {
    "picture": ("--velocity", "--background"),
    "film": ("--frame-rate", "--background"),
    "contour": ("--velocity", "--pixel-size", "--edge-error", "--contour-unit", "--contour-points"),
    ".rtdc file": ("--velocity", "--pixel-size"),
}


def measure(
    picture: Annotated[
        Path,
        typer.Argument(
            help="PNG, TIFF or JPEG of one capsule between the two walls; a film: AVI, MP4, TIFF of several pages, or "
            "a folder of pictures; a contour: CSV or text of points; or an .rtdc file."
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
    flow: Annotated[str | None, typer.Option(help="right or left; default: as the shape or the film tells.")] = None,
    pixel_size: Annotated[
        str | None, typer.Option(help='Of a contour or an .rtdc file, as "0.340 +/- 0.003 um".')
    ] = None,
    edge_error: Annotated[str | None, typer.Option(help='How well a contour lies on the edge, as "0.10 um".')] = None,
    contour_unit: Annotated[str | None, typer.Option(help="px or um, where a contour's columns do not say.")] = None,
    contour_points: Annotated[
        str | None, typer.Option(help="Of a contour of whole pixels: through their centres, or along their borders.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for measurement.toml, outline.csv and overlay.png.")] = None,
) -> None:
    """Measure the capsule in a picture, or all those in a film: lengths with their errors."""
    from capsbayes.cli.measure_film import measure_film
    from capsbayes.cli.measure_rtdc import measure_rtdc
    from capsbayes.errors import InputError
    from capsbayes.experiment import Experiment

    if out is not None and out.exists() and not out.is_dir():
        raise InputError("--out", "", "a folder", f"the file {out}")
    kind = _kind(picture)
    options = {
        "--velocity": velocity,
        "--frame-rate": frame_rate,
        "--background": background,
        "--pixel-size": pixel_size,
        "--edge-error": edge_error,
        "--contour-unit": contour_unit,
        "--contour-points": contour_points,
    }
    for option, given in options.items():
        if given is not None and option not in _TAKES[kind]:
            raise InputError("measure", option, f"one of {', '.join(_TAKES[kind])} for a {kind}", str(given))
    known = Experiment.read(experiment)
    if kind == "film":
        measure_film(picture, known, frame_rate=frame_rate, background=background, flow=flow, out=out)
    elif kind == ".rtdc file":
        measure_rtdc(picture, known, velocity=_speed(velocity), pixel_size=_pixel(pixel_size), flow=flow, out=out)
    elif kind == "contour":
        _measure_contour(
            picture, known, _speed(velocity), pixel_size, edge_error, contour_unit, contour_points, flow, out
        )
    else:
        _measure_picture(picture, known, _speed(velocity), background, flow, out)


def _kind(path: Path) -> str:
    from capsbayes.image.film import is_film

    suffix = path.suffix.lower()
    if suffix in _CONTOURS:
        return "contour"
    if suffix == ".rtdc":
        return ".rtdc file"
    return "film" if is_film(path) else "picture"


def _measure_picture(
    path: Path, experiment: Experiment, speed: Quantity, background: Path | None, flow: str | None, out: Path | None
) -> None:
    from capsbayes.image.frames import Picture
    from capsbayes.image.measure import measurement_of, sight

    seen = Picture.read(path)
    sighting = sight(seen, background=None if background is None else Picture.read(background), flow=flow)
    measured = measurement_of(sighting, seen, experiment, speed)
    if sighting.status.ok:
        _print(sighting, experiment)
    if out is not None:
        write_sighting(out, seen, sighting, measured)
    typer.echo(f"Status: {measured.status}")
    if not measured.status.ok:
        raise typer.Exit(1)


def _measure_contour(
    path: Path,
    experiment: Experiment,
    speed: Quantity,
    pixel_size: str | None,
    edge_error: str | None,
    unit: str | None,
    points: str | None,
    flow: str | None,
    out: Path | None,
) -> None:
    from capsbayes.errors import InputError
    from capsbayes.image.contour_file import ContourFile, measure_contour
    from capsbayes.quantity import quantity

    if flow is None:
        raise InputError("measure", "--flow", "right or left", "nothing", "a contour does not say")
    edge = quantity(edge_error, where="measure", key="--edge-error", units=("m",), example="0.10 um")
    measured = measure_contour(
        ContourFile.read(path, unit),
        experiment,
        capsule_velocity=speed,
        edge_error=edge,
        flow=flow,
        pixel_size=None if pixel_size is None else _pixel(pixel_size),
        points=points,
    )
    typer.echo(f"L_z {_pair(1e6 * measured.axial_extent, 1e6 * measured.axial_extent_error, digits=3)} um")
    if measured.axial_length is None or measured.axial_length_error is None:
        typer.echo("The contour has no concave rear: L_a is at most its length.")
    else:
        typer.echo(f"L_a {_pair(1e6 * measured.axial_length, 1e6 * measured.axial_length_error, digits=3)} um")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        measured.write(out / "measurement.toml")
    typer.echo(f"Status: {measured.status}")


def _speed(text: str | None) -> Quantity:
    return _with_error("--velocity", text, "m/s", "6.20 +/- 0.06 mm/s")


def _pixel(text: str | None) -> Quantity:
    return _with_error("--pixel-size", text, "m", "0.340 +/- 0.003 um")


def _with_error(option: str, text: str | None, unit: str, example: str) -> Quantity:
    from capsbayes.errors import InputError
    from capsbayes.quantity import quantity

    read = quantity(text, where=option, key="", units=(unit,), example=example)
    if read.error == 0.0:
        raise InputError(option, "", f'a standard error, as in "{example}"', repr(text))
    return read


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
    for name, _, in_pixels, over_l in _enclosed(sighting):
        table.add_row(name, _significant(in_pixels), _significant(over_l), "")
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


def _enclosed(sighting: Sighting) -> list[tuple[str, str, Integral, Integral]]:
    """Name, name with its unit, and values in powers of a pixel and of l of what the silhouette encloses."""
    import math

    from capsbayes.image.integrals import Integral

    inside = sighting.silhouette
    assert inside is not None, "of a capsule that was measured"
    l_px, l_error = float(sighting.lengths[3]), math.sqrt(float(sighting.covariance[3, 3]))
    rows = []
    for name, power, one in (
        ("perimeter", 1, inside.perimeter),
        ("area", 2, inside.area),
        ("volume", 3, inside.volume),
        ("Lambda", 0, inside.stretch_ratio),
    ):
        value = one.value / l_px**power
        share = math.hypot(one.error / one.value, power * l_error / l_px)
        symbol = f"{name}_over_l{power if power > 1 else ''}" if power else name
        shown = f"{name} ({_POWERS[power]})" if power > 1 else name
        rows.append((shown, symbol, one, Integral(value, value * share)))
    return rows


def _significant(one: Integral) -> str:
    import math

    return _pair(one.value, one.error, digits=max(0, 1 - math.floor(math.log10(one.error))))


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
        rows = [f"{name},{one.value:.6g},{one.error:.2g}" for _, name, _, one in _enclosed(sighting)]
        (out / "silhouette.csv").write_text("\n".join(["quantity,value,error", *rows]) + "\n")
