"""``capsbayes batch``: many measured capsules to their shear moduli and radii."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import (
    AsJson,
    Background,
    ExperimentFile,
    Flow,
    ModelName,
    Scheduler,
    Seed,
    Velocity,
    Workers,
    named_model,
)

if TYPE_CHECKING:
    from rich.table import Table

    from capsbayes.infer.many import Hierarchy, Population


_SHOWN = ("median", "lower_quartile", "upper_quartile", "error")


def batch(
    capsules: Annotated[
        Path,
        typer.Argument(
            help="Folder of measurement files and pictures, .csv, .parquet or .nc table of lengths, or .nc of outlines."
        ),
    ],
    out: Annotated[Path, typer.Option(help="NetCDF file to write; a .csv of the same name is written beside it.")],
    experiment: ExperimentFile = None,
    database: ModelName = None,
    velocity: Velocity = None,
    background: Background = None,
    flow: Flow = None,
    seed: Seed = 1,
    check: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the capsules that are sampled with emcee as well.")
    ] = 0.01,
    most_checked: Annotated[int, typer.Option(min=0, help="But no more than these.")] = 100,
    chains: Annotated[
        Path | None, typer.Option(help="Folder for the draws of every capsule, sampled with emcee: seconds each.")
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Identify many capsules; started again after an interruption, it goes on where it was.

    Exit status: 0 if every capsule has a row that can be used, 1 if some have another status, 2 on bad input.
    """
    import json

    from capsbayes.cli.measure_picture import speed_of
    from capsbayes.cli.paths import check_suffix
    from capsbayes.cli.population import together
    from capsbayes.experiment import Experiment
    from capsbayes.infer.many import identify_folder
    from capsbayes.infer.many.listing import cross_section_and_view

    check_suffix("batch", "--out", out, (".nc",))
    known = None if experiment is None else Experiment.read(experiment)
    cross_section, view = cross_section_and_view(capsules, known)
    population = identify_folder(
        capsules,
        named_model(database, cross_section, view),
        known,
        out=out,
        seed=seed,
        capsule_velocity=None if velocity is None else speed_of(velocity),
        background=background,
        flow=flow,
        check=check,
        most_checked=most_checked,
        chains=chains,
        scheduler=scheduler,
        workers=workers,
        progress=not as_json,
    )
    found = together(population, out, seed=seed)
    if as_json:
        typer.echo(json.dumps(_summary(population, found), indent=2))
    else:
        _print(population, found, out)
    if not population.usable.all():
        raise typer.Exit(1)


def _summary(population: Population, hierarchy: Hierarchy | None) -> dict[str, object]:
    """Counts, medians and ranges of the capsules that can be used, and what made them."""
    found = population.attributes
    return {
        "capsules": len(population),
        "statuses": {status.name: count for status, count in population.counts.items()},
        "quantities": _medians(population),
        "agreement": found.get("agreement"),
        "hierarchy": None if hierarchy is None else hierarchy.as_dict(),
        **{name: found[name] for name in ("model", "model_sha256", "experiment", "prior", "seed", "version")},
    }


def _medians(population: Population) -> dict[str, dict[str, float | str]]:
    """Of the usable capsules: median and quartiles of the medians, and the median half width of the 68 % interval."""
    import numpy as np

    from capsbayes.parameters import PARAMETERS

    rows: dict[str, dict[str, float | str]] = {}
    for name in ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio"):
        medians = population[f"{name}_median"][population.usable]
        if not len(medians):
            continue
        low, middle, high = (float(one) for one in np.quantile(medians, (0.25, 0.5, 0.75)))
        half = 0.5 * (population[f"{name}_upper_68"] - population[f"{name}_lower_68"])[population.usable]
        unit = PARAMETERS[name].unit
        error = float(np.median(half))
        rows[name] = {"median": middle, "lower_quartile": low, "upper_quartile": high, "error": error, "unit": unit}
    return rows


def _print(population: Population, hierarchy: Hierarchy | None, out: Path) -> None:
    from rich.console import Console

    from capsbayes.cli.population import print_hierarchy

    console = Console(highlight=False)
    console.print(f"{len(population)} capsules", style="bold")
    for status, count in population.counts.items():
        console.print(f"  {count:>7}  {status}", markup=False)
    console.print(_table(population))
    if hierarchy is not None:
        print_hierarchy(console, hierarchy)
    agreement = population.attributes.get("agreement")
    if isinstance(agreement, dict):
        from capsbayes.infer.many.sampled import Compared

        console.print(f"Check: {Compared(**agreement)}.", markup=False)
    found = population.attributes
    console.print(f"Model: {found['model']}, sha256 {found['model_sha256'][:12]}; seed {found['seed']}.")
    console.print(f"Written: {out}, {out.with_suffix('.csv')}.", markup=False)


def _table(population: Population) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    table = Table(title="Of the capsules that can be used", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("", "median", "quartiles", "error of one, 68 %"):
        table.add_column(heading, justify="left" if not heading else "right")
    for name, one in _medians(population).items():
        about = PARAMETERS[name]
        median, low, high, error = (about.shown(float(one[key])) for key in _SHOWN)
        table.add_row(escape(about.label), f"{median:.4g}", f"{low:.4g} to {high:.4g}", f"{error:.2g}")
    return table
