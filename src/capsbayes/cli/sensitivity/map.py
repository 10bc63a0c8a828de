"""``capsbayes sensitivity map``: how precisely a lab can measure G_s and a, over (Ca, a/l)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import AsJson, ModelName, lab_of, lengths_alone, named_model, with_options_of
from capsbayes.cli.output import Writer, conclude, figure_file, json_file, model_words
from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError
from capsbayes.files.output_file import write_dataset

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_MOST_POINTS = 200  # along an axis


@with_options_of(lab_of, "lab")
def identifiability(
    lab: Any,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for map.nc, map.json, map.png, map-radius.png."),
        Writes(within=("map.nc", "map.json", "map.png", "map-radius.png")),
    ] = None,
    database: ModelName = None,
    points: Annotated[tuple[int, int], typer.Option(help="Points along log Ca and along a/l.")] = (28, 20),
    noises: Annotated[int, typer.Option(min=0, max=10_000, help="Measurements that each width is averaged over.")] = 13,
    as_json: AsJson = False,
) -> None:
    """Map the relative width of G_s and a that a lab would get with its own errors.

    The map has no randomness. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.plan import identifiability_map
    from capsbayes.show import identifiability_figure
    from capsbayes.work import resumable, tracked

    if not all(2 <= count <= _MOST_POINTS for count in points):
        raise InputError("map", "--points", f"two numbers from 2 to {_MOST_POINTS}", " ".join(map(str, points)))
    stated, known, _ = lab
    errors = lengths_alone(stated)
    model = named_model(database, known.cross_section)
    with resumable(out):
        found = identifiability_map(model, known, errors, grid=points, noises=noises, progress=tracked)
        short = _short(found)
        files: dict[str, Writer] = {
            "map.nc": lambda path: write_dataset(path, found),
            "map.json": json_file(short),
            "map.png": figure_file(lambda: identifiability_figure(found)),
            "map-radius.png": figure_file(lambda: identifiability_figure(found, "capsule_radius")),
        }
        model_line = model_words(short["model"], short["model_sha256"])
        conclude(short, lambda: [*_lines(short), model_line], files, out=out, as_json=as_json)


def _short(found: xr.Dataset) -> dict[str, Any]:
    """Return the best point of the map, and the share of its points below some widths."""
    import json

    import numpy as np

    from capsbayes.infer.verdict import LEANING_SHARE

    width = found["width_of_surface_shear_modulus"].to_numpy()
    known = np.isfinite(width)
    measured = known & (found["leaning"].to_numpy() <= LEANING_SHARE)
    below = {f"{level:.0%}": float(np.mean(width[known] <= level)) for level in (0.05, 0.1, 0.2, 0.5)}
    return {
        "best": _best(found, np.where(measured, width, np.inf)),
        "share_of_points_with_width_below": below,
        "share_of_points_that_lean_on_the_border": float(1.0 - measured.sum() / known.sum()),
        "points": int(known.sum()),
        **{name: found.attrs[name] for name in ("model", "model_sha256", "cross_section", "version")},
        "noises": int(found.attrs["noises"]),
        **{name: json.loads(found.attrs[name]) for name in ("experiment", "errors")},
    }


def _best(found: xr.Dataset, width: Floats) -> dict[str, float] | None:
    """Return the smallest width and its point; None where none is measured."""
    import numpy as np

    if not np.isfinite(width).any():
        return None
    row, column = np.unravel_index(np.argmin(width), width.shape)
    return {
        "capillary_number": float(found["capillary_number"][column]),
        "size_ratio": float(found["size_ratio"][row]),
        "width_of_surface_shear_modulus": float(width[row, column]),
        "width_of_capsule_radius": float(found["width_of_capsule_radius"][row, column]),
    }


def _lines(short: dict[str, Any]) -> list[str]:
    best, below = short["best"], short["share_of_points_with_width_below"]
    first = (
        "With these errors G_s cannot be measured anywhere on the map."
        if best is None
        else (
            f"G_s is measured best at Ca = {best['capillary_number']:.3g}, a/l = {best['size_ratio']:.3g}: to ± "
            f"{best['width_of_surface_shear_modulus']:.1%}, and a to ± {best['width_of_capsule_radius']:.1%} "
            "(half of the 68 % interval over the median)."
        )
    )
    return [
        first,
        f"Of {short['points']} points, " + ", ".join(f"{share:.0%} to {level}" for level, share in below.items()) + ".",
        f"At {short['share_of_points_that_lean_on_the_border']:.0%} of them the posterior leans on the border of the "
        "database: the width is cut there, and not measured.",
    ]
