"""``capsbayes sensitivity map``: how precisely a lab can measure G_s and a, over (Ca, a/l)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import (
    AsJson,
    Guess,
    MembraneKnown,
    ModelName,
    Priors,
    lab_of,
    lengths_alone,
    membrane_of,
    named_model,
    prior_of,
    with_options_of,
)
from capsbayes.cli.output import conclude, model_words
from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError
from capsbayes.files.output_file import write_dataset
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    import xarray as xr
    from numpy.typing import NDArray

    from capsbayes.experiment import Experiment
    from capsbayes.plan import LabErrors
    from capsbayes.surrogate import EffectSurrogate, Surrogate

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
    membrane: MembraneKnown = None,
    guess: Guess = None,
    prior: Priors = None,
    points: Annotated[
        tuple[int, int] | None,
        typer.Option(help="Points along log Ca and along a/l; default: 28 20, with the membrane unknown 10 6."),
    ] = None,
    noises: Annotated[
        int | None,
        typer.Option(min=0, max=10_000, help="Measurements that each width is averaged over; default: 13."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Map the relative width of G_s and a that a lab would get with its own errors.

    With --membrane, the standard deviation of ln G_s with the membrane unknown, next to that with it known.

    The map has no randomness. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.run import resumable

    if points is not None and not all(2 <= count <= _MOST_POINTS for count in points):
        raise InputError("map", "--points", f"two numbers from 2 to {_MOST_POINTS}", " ".join(map(str, points)))
    errors, known, stated = lab
    sheet = membrane_of(stated, membrane)
    of_membrane = {"--guess": guess, "--prior": prior}
    of_law = {"--database": database, "--noises": noises}
    for option, given in (of_membrane if sheet is None else of_law).items():
        if given is not None:
            what = "--membrane with it" if sheet is None else "no such option with the membrane unknown"
            raise InputError("map", option, what, str(given))
    with resumable(out):
        if sheet is None:
            model = named_model(database, known.cross_section)
            _print_map(model, known, lengths_alone(errors), points, noises, out, as_json)
        else:
            lab_of_map = {"membrane": sheet, "guess": membrane_of(None, guess, "--guess"), "prior": prior_of(prior)}
            _print_membrane_map(known, errors, lab_of_map, points, out, as_json)


def _print_map(
    model: Surrogate | EffectSurrogate,
    known: Experiment,
    errors: LabErrors,
    points: tuple[int, int] | None,
    noises: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Compute the map of a known law, print and write it."""
    from capsbayes.plan import identifiability_map
    from capsbayes.plan.membrane import MEMBRANE_GRID
    from capsbayes.plan.widths import NOISES
    from capsbayes.report import identifiability_figure
    from capsbayes.run import tracked

    count = NOISES if noises is None else noises
    found = identifiability_map(model, known, errors, grid=points or MEMBRANE_GRID, noises=count, progress=tracked)
    short = _short(found)
    files: dict[str, Writer] = {
        "map.nc": lambda path: write_dataset(path, found),
        "map.json": json_file(short),
        "map.png": figure_file(lambda: identifiability_figure(found)),
        "map-radius.png": figure_file(lambda: identifiability_figure(found, "capsule_radius")),
    }
    model_line = model_words(short["model"], short["model_sha256"])
    conclude(short, lambda: [*_lines(short), model_line], files, out=out, as_json=as_json)


def _print_membrane_map(
    known: Experiment,
    errors: LabErrors,
    of_membrane: dict[str, Any],
    points: tuple[int, int] | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Compute the map with the membrane unknown, print and write it."""
    from capsbayes.plan import membrane_map
    from capsbayes.plan.membrane import MEMBRANE_GRID
    from capsbayes.report.plan import expected_words, membrane_map_figure, membrane_map_table
    from capsbayes.run import tracked

    found = membrane_map(known, errors, **of_membrane, grid=points or MEMBRANE_GRID, progress=tracked)
    short = _short_of_membrane(found)
    files: dict[str, Writer] = {
        "map.nc": lambda path: write_dataset(path, found),
        "map.json": json_file(short),
        "map.png": figure_file(lambda: membrane_map_figure(found)),
    }
    model_line = model_words(short["model"], short["model_sha256"])
    shown: list[str | pd.DataFrame] = [
        membrane_map_table(short["quantiles"]),
        expected_words(short["membrane"]),
        model_line,
    ]
    conclude(short, lambda: shown, files, out=out, as_json=as_json)


def _short_of_membrane(found: xr.Dataset) -> dict[str, Any]:
    """Return quantiles of the standard deviations over the map, and what it holds for."""
    import json

    import numpy as np

    quantiles = {}
    for name in map(str, found.data_vars):
        if found[name].ndim == 2:
            values = found[name].to_numpy()
            levels = np.quantile(values[np.isfinite(values)], [0.0, 0.25, 0.5, 0.75, 1.0])
            quantiles[name] = dict(zip(("least", "lower", "median", "upper", "most"), levels.tolist(), strict=True))
    return {
        "quantiles": quantiles,
        "points": int(np.isfinite(found["unknown_lengths"].to_numpy()).sum()),
        **{name: found.attrs[name] for name in ("model", "model_sha256", "cross_section", "version")},
        **{name: json.loads(found.attrs[name]) for name in ("experiment", "errors", "membrane")},
    }


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
        f"Share of the {short['points']} points at which the width of G_s is at most "
        + ", ".join(f"{level}: {share:.0%}" for level, share in below.items())
        + ".",
        f"At {short['share_of_points_that_lean_on_the_border']:.0%} of them the posterior leans on the border of the "
        "database: the width is cut there, and not measured.",
    ]
