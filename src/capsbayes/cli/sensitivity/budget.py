"""``capsbayes sensitivity budget``: which input owns how much of the interval of one capsule."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import AsJson, CapsuleFile, ExperimentFile, ModelName, Seed, named_experiment, named_model


def budget(
    capsule: CapsuleFile,
    out: Annotated[Path | None, typer.Option(help="Folder for budget.json, budget.csv, budget.png.")] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Share of the variance of G_s and a owed to each input, and how both follow a change of it.

    Exit status: 0 done, 1 the posterior ended with a status to read, 2 bad input.
    """
    from rich.console import Console

    from capsbayes.cli.paths import check_folder, filled
    from capsbayes.cli.printing import model_words, print_json, write_study, written_words
    from capsbayes.infer import Prior, identify
    from capsbayes.measurement import Measurement
    from capsbayes.plan import error_budget

    check_folder("--out", out)
    measurement = Measurement.read(capsule)
    known = named_experiment(measurement, experiment)
    model = named_model(
        database, known.cross_section, None if measurement.outline is None else measurement.outline.view
    )
    prior = Prior.read(capsule)
    with Console(stderr=True).status("Computing the budget ..."):
        posterior = identify(measurement, model, known, engine="quadrature", seed=seed, prior=prior)
        found = error_budget(posterior, model)
    everything = {**found.as_dict(), "seed": seed}
    if out is not None:
        from capsbayes.show import budget_figure

        with filled(out) as folder:
            write_study(folder, "budget", everything, budget_figure(found))
            found.table().to_csv(folder / "budget.csv", index_label="input")
    if as_json:
        print_json(everything)
    else:
        from capsbayes.show.tables.plan import budget_table
        from capsbayes.show.tables.table import print_parts

        model_line = model_words(found.model_name, found.model_sha256, seed)
        files = written_words(out, "budget.json", "budget.csv", "budget.png")
        print_parts(budget_table(found), *found.notes, model_line, files, status=found.status, good=found.status.ok)
    if not found.status.ok:
        raise typer.Exit(1)
