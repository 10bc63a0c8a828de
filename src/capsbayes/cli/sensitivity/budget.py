"""``capsbayes sensitivity budget``: the share of the interval of one capsule due to each input."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import (
    AsJson,
    CapsuleFile,
    ExperimentFile,
    MembraneKnown,
    ModelName,
    Seed,
    capsule_model,
    membrane_of,
    named_experiment,
)
from capsbayes.cli.output import conclude, model_words, table_file
from capsbayes.cli.paths import Writes
from capsbayes.report.files import Writer, figure_file, json_file


def budget(
    capsule: CapsuleFile,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for budget.json, budget.csv, budget.png."),
        Writes(within=("budget.json", "budget.csv", "budget.png")),
    ] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    membrane: MembraneKnown = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Compute the share of the variance of G_s and a due to each input, and how both change with it.

    With --membrane, what is not known of the membrane has shares too.

    Exit status: 0 done, 1 the posterior cannot be used (the status says why), 2 bad input.
    """
    from rich.console import Console

    from capsbayes.infer import Membrane, Prior, identify
    from capsbayes.measurement import Measurement
    from capsbayes.plan import error_budget
    from capsbayes.report import budget_figure
    from capsbayes.report.plan import budget_table
    from capsbayes.run import resumable

    measurement = Measurement.read(capsule)
    sheet = membrane_of(Membrane.read(capsule), membrane)
    known = named_experiment(measurement, experiment)
    view = None if measurement.outline is None else measurement.outline.view
    model, prior = capsule_model(database, sheet, known.cross_section, view), Prior.read(capsule)
    if sheet is not None:
        model, prior = sheet.applied(model, prior)
    with resumable(out):
        with Console(stderr=True).status("Computing the budget ..."):
            posterior = identify(measurement, model, known, engine="quadrature", seed=seed, prior=prior)
            found = error_budget(posterior, model)
        result = {**found.as_dict(), "seed": seed}
        files: dict[str, Writer] = {
            "budget.json": json_file(result),
            "budget.csv": table_file(found.table(), index_label="input"),
            "budget.png": figure_file(lambda: budget_figure(found)),
        }
        model_line = model_words(found.model_name, found.model_sha256, seed)
        conclude(
            result,
            lambda: [budget_table(found), *found.notes, model_line],
            files,
            out=out,
            as_json=as_json,
            status=found.status,
        )
