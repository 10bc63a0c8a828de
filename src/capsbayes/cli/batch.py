"""``capsbayes batch``: shear moduli and radii of many measured capsules."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import (
    BY_HAND,
    AsJson,
    Background,
    ExperimentFile,
    Flow,
    FlowRate,
    ModelName,
    Priors,
    Scheduler,
    Seed,
    SharedVelocity,
    Velocity,
    Workers,
    by_hand_of,
    named_model,
    prior_texts,
    speeds_of,
    with_options_of,
)
from capsbayes.cli.output import model_words, print_json
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError

if TYPE_CHECKING:
    from capsbayes.infer.hierarchy import Hierarchy
    from capsbayes.infer.population import Population


_SHOWN = ("median", "lower_quartile", "upper_quartile", "error", "unit")


@with_options_of(by_hand_of, "by_hand")
def batch(
    capsules: Annotated[
        Path,
        typer.Argument(
            help="Folder of measurement files and pictures, .csv, .parquet or .nc table of lengths, or .nc of outlines."
        ),
        Reads(),
    ],
    out: Annotated[
        Path,
        typer.Option(help="NetCDF file to write; a .csv of the same name is written next to it."),
        Writes(".nc", next_to=("{stem}.csv", "{name}.parts/")),
    ],
    experiment: ExperimentFile = None,
    database: ModelName = None,
    prior: Priors = None,
    velocity: Velocity = None,
    flow_rate: FlowRate = None,
    shared_velocity: SharedVelocity = None,
    background: Background = None,
    flow: Flow = None,
    by_hand: Any = None,
    seed: Seed = 1,
    check: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the capsules that are sampled with emcee as well.")
    ] = 0.01,
    most_checked: Annotated[int, typer.Option(min=0, help="But no more than these.")] = 100,
    chains: Annotated[
        Path | None,
        typer.Option(help="Folder for the draws of every capsule, sampled with emcee: seconds each."),
        Writes(),
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Identify many capsules; after an interruption, a second run continues where the first stopped.

    Exit status: 0 if every capsule has a row that can be used, 1 if some have another status, 2 on bad input.
    """
    from capsbayes.cli.population import together
    from capsbayes.experiment import Experiment
    from capsbayes.infer import Prior
    from capsbayes.infer.batch import check_there, cross_section_and_view, identify_folder, pictures_of

    stated = {option: by_hand and getattr(by_hand, name) for name, option in BY_HAND.items()}
    speeds = {"--velocity": velocity, "--shared-velocity": shared_velocity, "--flow-rate": flow_rate}
    for option, given in {**speeds, "--background": background, "--flow": flow, **stated}.items():
        if given is not None and not capsules.is_dir():
            check_there(capsules)
            advice = "a table states it in its columns" if option in speeds else ""
            raise InputError("batch", option, "a folder of pictures", str(capsules), advice)
    known = None if experiment is None else Experiment.read(experiment)
    cross_section, view = cross_section_and_view(capsules, known)
    pictures = pictures_of(capsules) if capsules.is_dir() else ()
    several = "" if len(pictures) == 1 and velocity is not None else f"{len(pictures)} pictures"
    found_speeds = speeds_of(speeds, None, several)
    population = identify_folder(
        capsules,
        named_model(database, cross_section, view),
        known,
        out=out,
        seed=seed,
        prior=Prior().with_texts(prior_texts(prior), where="--prior"),
        shared_velocity=found_speeds.get("capsule_velocity"),
        flow_rate=found_speeds.get("flow_rate"),
        background=background,
        flow=flow,
        by_hand=by_hand,
        check=check,
        most_checked=most_checked,
        chains=chains,
        scheduler=scheduler,
        workers=workers,
        progress=not as_json,
    )
    found = together(population, out, seed=seed)
    if as_json:
        print_json(_summary(population, found))
    else:
        _print(population, found, out)
    if not population.usable.all():
        raise typer.Exit(1)


def _summary(population: Population, hierarchy: Hierarchy | None) -> dict[str, object]:
    """Return counts, medians and ranges of the capsules that can be used, and what made them."""
    found = population.attributes
    return {
        "capsules": len(population),
        "statuses": {status.name: count for status, count in population.counts.items()},
        "quantities": population.summary()[list(_SHOWN)].to_dict(orient="index") if population.usable.any() else {},
        "agreement": found.get("agreement"),
        "hierarchy": None if hierarchy is None else hierarchy.as_dict(),
        **{name: found[name] for name in ("model", "model_sha256", "experiment", "prior", "seed", "version")},
    }


def _print(population: Population, hierarchy: Hierarchy | None, out: Path) -> None:
    from capsbayes.infer.batch import Compared
    from capsbayes.report.population import hierarchy_parts, population_parts
    from capsbayes.report.tables import print_parts

    attributes = population.attributes
    agreement = attributes.get("agreement")
    print_parts(
        *population_parts(population),
        *(() if hierarchy is None else hierarchy_parts(hierarchy)),
        f"Check: {Compared(**agreement)}." if isinstance(agreement, dict) else "",
        model_words(attributes["model"], attributes["model_sha256"], attributes["seed"]),
        f"Written: {out}, {out.with_suffix('.csv')}.",
    )
