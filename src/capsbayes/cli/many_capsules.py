"""Commands of many capsules: their shear moduli and radii, the population that they are of, the membrane they share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import capsbayes as cb
from capsbayes.cli import options
from capsbayes.cli.command import Input, Option, Writes, command, results, wants_json
from capsbayes.cli.output import conclude, model_words
from capsbayes.errors import InputError
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    import pandas as pd

_ENOUGH = 10  # capsules, for a population to be inferred unasked
_SHOWN = ("median", "lower_quartile", "upper_quartile", "error", "unit")


@command
def batch(
    capsules: Annotated[
        Path,
        Input("Folder of measurement files and pictures, .csv, .parquet or .nc table of lengths, or .nc of outlines."),
    ],
    out: Annotated[
        Path,
        Writes(
            "NetCDF file to write; a .csv of the same name is written next to it.",
            ".nc",
            next_to=("{stem}.csv", "{name}.parts/"),
        ),
    ],
    experiment: options.ExperimentFile = None,
    database: options.ModelName = None,
    prior: options.Priors = None,
    *,
    stated: options.PicturesOptions,
    seed: options.Seed = 1,
    check: Annotated[
        float, Option("Share of the capsules that are sampled with emcee as well.", min=0.0, max=1.0)
    ] = 0.01,
    most_checked: Annotated[int, Option("But no more than these.", min=0)] = 100,
    chains: Annotated[
        Path | None, Writes("Folder for the draws of every capsule, sampled with emcee: seconds each.")
    ] = None,
    scheduler: options.Scheduler = None,
    workers: options.Workers = None,
) -> None:
    """Identify many capsules; after an interruption, a second run continues where the first stopped.

    Exit status: 0 if every capsule has a row that can be used, 1 if some have another status, 2 on bad input.
    """
    from capsbayes.infer.batch import cross_section_and_view

    _check_stated(stated, capsules)
    known = None if experiment is None else cb.Experiment.read(experiment)
    cross_section, view = cross_section_and_view(capsules, known)
    population = cb.identify_folder(
        capsules,
        options.named_model(database, cross_section, view),
        known,
        out=out,
        seed=seed,
        prior=options.prior_of(prior),
        **_of_pictures(stated, capsules),
        check=check,
        most_checked=most_checked,
        chains=chains,
        scheduler=scheduler,
        workers=workers,
        progress=not wants_json.get(),
    )
    hierarchy = _inferred(population, out, seed=seed)
    parts = _batch_parts(population, hierarchy, out)
    conclude(batch_summary(population, hierarchy), parts, good=bool(population.usable.all()))


def _check_stated(stated: options.PicturesOptions, capsules: Path) -> None:
    """Refuse what is stated of pictures where there is no folder of them."""
    from capsbayes.infer.batch import check_there

    for option in () if capsules.is_dir() else stated.given():
        check_there(capsules)
        of_table = option in ("--velocity", "--shared-velocity", "--flow-rate")
        advice = "a table states it in its columns" if of_table else ""
        raise InputError("batch", option, "a folder of pictures", str(capsules), advice)


def _of_pictures(stated: options.PicturesOptions, capsules: Path) -> dict[str, Any]:
    """Return what is stated of the pictures in a folder, by the names of the library."""
    from capsbayes.infer.batch import pictures_of

    pictures = pictures_of(capsules) if capsules.is_dir() else ()
    one = len(pictures) == 1 and stated.velocity is not None
    speeds = stated.speeds(None, "" if one else f"{len(pictures)} pictures")
    how = {"shared_velocity": speeds.get("capsule_velocity"), "flow_rate": speeds.get("flow_rate")}
    return how | {"background": stated.background, "flow": stated.flow, "by_hand": stated.by_hand()}


def _inferred(population: cb.Population, out: Path, *, seed: int) -> cb.Hierarchy | None:
    """Infer what capsules have in common and store it with them; None if they are few, or of several experiments."""
    if int(population.usable.sum()) < _ENOUGH:
        return None
    try:
        inferred = cb.hierarchy(population, seed=seed)
    except InputError:
        return None
    if inferred.passed:
        inferred.added_to(population).write(out)
    return inferred


def batch_summary(population: cb.Population, hierarchy: cb.Hierarchy | None) -> dict[str, object]:
    """Return counts, medians and ranges of the capsules that can be used, and what made them."""
    made = population.attributes
    return {
        "capsules": len(population),
        "statuses": {status.name: count for status, count in population.counts.items()},
        "quantities": population.summary()[list(_SHOWN)].to_dict(orient="index") if population.usable.any() else {},
        "agreement": made.get("agreement"),
        "hierarchy": None if hierarchy is None else hierarchy.as_dict(),
        **{name: made[name] for name in ("model", "model_sha256", "experiment", "prior", "seed", "version")},
    }


def _batch_parts(population: cb.Population, hierarchy: cb.Hierarchy | None, out: Path) -> Iterator[str | pd.DataFrame]:
    from capsbayes.infer.batch import Compared
    from capsbayes.report.population import hierarchy_parts, population_parts

    made = population.attributes
    yield from population_parts(population)
    if hierarchy is not None:
        yield from hierarchy_parts(hierarchy)
    if isinstance(made.get("agreement"), dict):
        yield f"Check: {Compared(**made['agreement'])}."
    yield model_words(made["model"], made["model_sha256"], made["seed"])
    yield f"Written: {out}, {out.with_suffix('.csv')}."


@command
def population(
    capsules: Annotated[Path, Input("NetCDF file of capsbayes batch; the result is stored in it too.", updated=True)],
    least_stretch: Annotated[
        float | None,
        Option(
            "Keep capsules with a larger Lambda only, as the published 1.04, and account for it.", min=1.0, max=10.0
        ),
    ] = None,
    tails: Annotated[
        str, Option("Of the population: normal, or student for t distributions, for a few odd capsules.")
    ] = "normal",
    database: options.ModelName = None,
    experiment: options.ExperimentFile = None,
    velocity_error: Annotated[
        str | None, Option("Relative error that all velocities have in common, as '0.5 %': pixel size, frame rate.")
    ] = None,
    median_modulus: Annotated[
        str | None,
        Option("Median G_s of the batch by another experiment, as '50 +/- 4 mN/m' by compression or AFM."),
    ] = None,
    seed: options.Seed = 1,
) -> None:
    """Find mean and spread of G_s and a with the errors removed, and how G_s changes with a.

    Exit status: 0 if the intervals can be used, 1 if not, 2 on bad input.
    """
    from capsbayes.report.population import hierarchy_parts
    from capsbayes.run import only_run

    if not capsules.exists():
        raise InputError(str(capsules), "", "the file of a population", "nothing there")
    with only_run(capsules):
        read = cb.Population.read(capsules)
        stored = least_stretch is None and database is None and read.limit is not None
        inferred = cb.hierarchy(
            read,
            seed=seed,
            least_stretch=least_stretch,
            model=None if stored else cb.Surrogate.open(database or read.attributes["model"]),
            experiment=None if experiment is None else cb.Experiment.read(experiment),
            shared_velocity_error=_share(velocity_error),
            tails=tails,
            median_modulus=median_modulus,
        )
        if inferred.passed:
            inferred.added_to(read).write(capsules)
    conclude(inferred.as_dict(), hierarchy_parts(inferred), good=inferred.passed)


def _share(text: str | None) -> float:
    """Return a relative error, given as a number or in per cent."""
    if text is None:
        return 0.0
    try:
        number = float(text.replace("%", "").strip()) * (0.01 if "%" in text else 1.0)
    except ValueError:
        number = -1.0
    if not 0.0 <= number < 1.0:
        raise InputError("--velocity-error", "", "a share as '0.5 %' or 0.005", repr(text))
    return number


@command
def membrane(
    capsules: options.CapsulesFile,
    out: Annotated[Path | None, results("membrane.nc", "membrane.json", "membrane.png")] = None,
    experiment: options.ExperimentFile = None,
    membrane: options.MembraneKnown = None,
    prior: options.Priors = None,
    same_capsule: Annotated[
        bool, Option("All measurements are of one capsule, at several flow rates.", "--same-capsule")
    ] = False,
    inflation_varies: Annotated[
        bool, Option("Each capsule has a pre-inflation of its own.", "--inflation-varies")
    ] = False,
    scale_error: options.ScaleError = 0.0,
    refine: options.Refine = None,
    laws: Annotated[bool, Option("Compare known laws, which takes three times as long.")] = True,
    scheduler: options.Scheduler = None,
    workers: options.Workers = None,
    seed: options.Seed = 1,
) -> None:
    """Find the membrane that the capsules of a batch share: law, moduli, inflation and bending, with G_s and a of each.

    With --out, a run that was interrupted goes on where it was when it is started again.

    Exit status: 0 if the intervals can be used, 1 if not, 2 on bad input.
    """
    from capsbayes.measurement_sets import read_set
    from capsbayes.report.membrane import membrane_figure, membrane_parts
    from capsbayes.run import progress_bar, resumable

    measured = read_set(capsules, experiment)
    batch = measured.measurements, measured.experiment
    how: dict[str, Any] = {
        "seed": seed,
        "membrane": options.membrane_of(None, membrane),
        "prior": options.prior_of(prior),
        "same_capsule": same_capsule,
        "inflation_varies": inflation_varies,
        "scale_error": scale_error,
        "scheduler": scheduler,
        "workers": workers,
    }
    with resumable(out):
        refined = None
        if refine is not None:
            refined = cb.refine_model(*batch, states=refine, progress=not wants_json.get(), **how)
        with progress_bar(None, "membrane") as update:
            how |= {"laws": laws, "progress": lambda step, done, steps: update(done, step, steps)}
            shared = cb.identify_membrane(*batch, model=refined.model if refined else None, **how)
        if refined:
            shared = refined.noted_in(shared)
        result = shared.as_dict()
        files: dict[str, Writer] = {
            "membrane.nc": shared.write,
            "membrane.json": json_file(result),
            "membrane.png": figure_file(lambda: membrane_figure(shared)),
        }
        left_out = [f"Left out: {line}" for line in measured.left_out]
        parts = [*membrane_parts(shared), *left_out, model_words(**result["model"], seed=seed)]
        conclude(result, parts, files, out=out, status=shared.status)
