"""``capsbayes measure`` of a picture: what was found in it, printed and written; `identify` begins with it too."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.image.frames import Picture
    from capsbayes.image.integrals import Integral
    from capsbayes.image.sighting import Sighting
    from capsbayes.measurement import Measurement
    from capsbayes.quantity import Quantity

_POWERS = {2: "squared", 3: "cubed"}


def measured_picture(
    path: Path,
    experiment: Experiment,
    speed: Quantity,
    background: Path | None,
    flow: str | None,
    out: Path | None,
    *,
    quiet: bool = False,
) -> Measurement:
    """Measure the capsule in a picture, print what was found and write it; what failed ends the command.

    Parameters
    ----------
    path : Path
    experiment : Experiment
    speed : Quantity [m/s]
        Velocity of the capsule with its standard error.
    background : Path, optional
        Picture of the empty channel.
    flow : str, optional
        ``"right"`` or ``"left"``.
    out : Path, optional
        Folder.
    quiet : bool
        Whether to print nothing but why it failed.
    """
    from capsbayes.image.frames import Picture
    from capsbayes.image.measure import measurement_of, sight

    seen = Picture.read(path)
    sighting = sight(seen, background=None if background is None else Picture.read(background), flow=flow)
    measured = measurement_of(sighting, seen, experiment, speed)
    if sighting.status.ok and not quiet:
        _print(sighting, experiment)
        _print_outline(measured)
    if out is not None:
        write_sighting(out, seen, sighting, measured)
    if not (quiet and measured.status.ok):
        typer.echo(f"Status: {measured.status}", err=quiet)
    if not measured.status.ok:
        raise typer.Exit(1)
    return measured


def _print_outline(measured: Measurement) -> None:
    if measured.outline is None:
        typer.echo("The shape does not tell its front from its rear: no silhouette is kept. Say --flow.")
        return
    noise, pose = measured.outline.noise, measured.outline.pose
    typer.echo(
        f"Silhouette: {len(measured.outline.points)} points, each wrong by {noise.scale:.4f} l, of which "
        f"{1.0 - noise.white:.0%} of the variance is alike over {noise.correlation_length:.2f} l of the edge, "
        f"and all by {pose.offset:.4f} l."
    )


def _print(sighting: Sighting, experiment: Experiment) -> None:
    import numpy as np
    from rich import box
    from rich.console import Console
    from rich.table import Table

    centre, error = experiment.half_width.mean, experiment.half_width.sd
    micrometres, spread = 1e6 * centre, error / centre
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
        table.add_row(name, pair(*shown[0]), pair(*shown[1], digits=4), pair(shown[2][0], real))
    table.add_row("l", pair(l_px, l_error), "1", f"{micrometres:.2f} +/- {spread * micrometres:.2f}")
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

    return pair(one.value, one.error, digits=max(0, 1 - math.floor(math.log10(one.error))))


def pair(value: float, error: float, *, digits: int = 2) -> str:
    """A value with its standard error, as text."""
    return f"{value:.{digits}f} +/- {error:.{digits}f}"


def speed_of(text: str | None) -> Quantity:
    """Read ``--velocity``, which must have an error."""
    return _with_error("--velocity", text, "m/s", "6.20 +/- 0.06 mm/s")


def pixel_size_of(text: str | None) -> Quantity:
    """Read ``--pixel-size``, which must have an error."""
    return _with_error("--pixel-size", text, "m", "0.340 +/- 0.003 um")


def _with_error(option: str, text: str | None, unit: str, example: str) -> Quantity:
    from capsbayes.errors import InputError
    from capsbayes.quantity import Quantity

    read = Quantity.read(text, where=option, key="", units=(unit,), example=example)
    if read.error == 0.0:
        raise InputError(option, "", f'a standard error, as in "{example}"', repr(text))
    return read


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
