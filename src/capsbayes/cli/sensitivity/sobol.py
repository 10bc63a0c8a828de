"""``capsbayes sensitivity sobol``: how much of the spread of the answer each input causes, varied over its range."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, CapsuleFile, ExperimentFile, ModelName, Seed, named_experiment, named_model
from capsbayes.cli.output import conclude, model_words
from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    from capsbayes.plan import SobolStudy
    from capsbayes.quantity import Quantity


def sobol(
    capsule: CapsuleFile,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            help="Range of an input, as viscosity='0.80 .. 0.90 Pa s' (each value as likely) or "
            "axial_extent='2.14 +/- 0.02'; default: mean and error of the capsule and its experiment.",
        ),
    ] = None,
    samples: Annotated[int, typer.Option(min=8, max=2**16, help="Groups of samples, a power of two.")] = 1024,
    out: Annotated[
        Path | None, typer.Option(help="Folder for sobol.json, sobol.png."), Writes(within=("sobol.json", "sobol.png"))
    ] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Compute the Sobol indices of the deterministic answer (G_s, a, Ca, a/l) over ranges of the inputs.

    Exit status: 0 done, 1 the ranges leave the database, 2 bad input.
    """
    from rich.console import Console

    from capsbayes.measurement import Measurement
    from capsbayes.plan import sobol_indices
    from capsbayes.report import sobol_figure
    from capsbayes.report.plan import sobol_table
    from capsbayes.run import resumable

    stated = _stated(ranges or [])
    measurement = Measurement.read(capsule)
    known = named_experiment(measurement, experiment)
    model = named_model(database, known.cross_section)
    with resumable(out):
        with Console(stderr=True).status("Answering the samples ..."):
            study = sobol_indices(measurement, model, known, seed=seed, ranges=stated, samples=samples)
        files: dict[str, Writer] = {
            "sobol.json": json_file(study.as_dict()),
            "sobol.png": figure_file(lambda: sobol_figure(study)),
        }
        model_line = model_words(study.model_name, study.model_sha256, study.seed)
        conclude(
            study.as_dict(),
            lambda: [sobol_table(study), *_lines(study), model_line],
            files,
            out=out,
            as_json=as_json,
            status=study.status,
        )


def _stated(texts: list[str]) -> dict[str, Quantity]:
    """Return the range of each option ``--range NAME=TEXT``."""
    from capsbayes.plan import varied_range

    found = {}
    for text in texts:
        name, equals, stated = text.partition("=")
        if not equals:
            raise InputError("--range", "", "NAME=RANGE", repr(text))
        found[name.strip()] = varied_range(stated, name.strip(), where="--range")
    return found


def _lines(study: SobolStudy) -> list[str]:
    lines = [f"{study.samples} samples in {study.groups} groups."]
    if study.outside:
        share = study.outside / study.samples
        lines.append(
            f"{study.outside} of them ({share:.1%}) have a shape that no capsule of the database has; they were given "
            f"the answer of the nearest shape. Without their groups the indices of G_s and a change by at most "
            f"{study.change:.3f}."
        )
    return [*lines, *study.notes]
