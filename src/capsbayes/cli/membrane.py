"""``capsbayes membrane``: the membrane that the capsules of a batch share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import (
    AsJson,
    ExperimentFile,
    MembraneKnown,
    Priors,
    ScaleError,
    Scheduler,
    Seed,
    Workers,
    membrane_of,
    prior_of,
)
from capsbayes.cli.output import conclude, model_words
from capsbayes.cli.paths import Reads, Writes
from capsbayes.report.files import Writer, figure_file, json_file


def membrane(
    capsules: Annotated[
        Path,
        typer.Argument(help="Folder of measurement files, .csv table of lengths, or .nc file of outlines."),
        Reads(),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for membrane.nc, membrane.json and membrane.png."),
        Writes(within=("membrane.nc", "membrane.json", "membrane.png")),
    ] = None,
    experiment: ExperimentFile = None,
    known: MembraneKnown = None,
    prior: Priors = None,
    same_capsule: Annotated[
        bool, typer.Option("--same-capsule", help="All measurements are of one capsule, at several flow rates.")
    ] = False,
    inflation_varies: Annotated[
        bool, typer.Option("--inflation-varies", help="Each capsule has a pre-inflation of its own.")
    ] = False,
    scale_error: ScaleError = 0.0,
    laws: Annotated[bool, typer.Option(help="Compare known laws, which takes three times as long.")] = True,
    scheduler: Scheduler = None,
    workers: Workers = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Find the membrane that the capsules of a batch share: law, moduli, inflation and bending, with G_s and a of each.

    With --out, a run that was interrupted goes on where it was when it is started again.

    Exit status: 0 if the intervals can be used, 1 if not, 2 on bad input.
    """
    from capsbayes.infer.shared_membrane import identify_membrane
    from capsbayes.measurement_sets import read_set
    from capsbayes.report.membrane import membrane_figure, membrane_parts
    from capsbayes.run import progress_bar, resumable

    measured = read_set(capsules, experiment)
    with resumable(out):
        with progress_bar(None, "membrane") as update:
            found = identify_membrane(
                measured.measurements,
                measured.experiment,
                seed=seed,
                membrane=membrane_of(None, known),
                prior=prior_of(prior),
                same_capsule=same_capsule,
                inflation_varies=inflation_varies,
                scale_error=scale_error,
                laws=laws,
                scheduler=scheduler,
                workers=workers,
                progress=lambda step, done, steps: update(done, step, steps),
            )
        files: dict[str, Writer] = {
            "membrane.nc": found.write,
            "membrane.json": json_file(found.as_dict()),
            "membrane.png": figure_file(lambda: membrane_figure(found)),
        }
        left_out = [f"Left out: {line}" for line in measured.left_out]
        model_line = model_words(found.model_name, found.model_sha256, found.seed)
        conclude(
            found.as_dict(),
            lambda: [*membrane_parts(found), *left_out, model_line],
            files,
            out=out,
            as_json=as_json,
            status=found.status,
        )
