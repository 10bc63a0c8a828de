"""``capsbayes sensitivity sobol``: which input, varied over its range, moves the answer how much."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, CapsuleFile, ExperimentFile, ModelName, Seed, named_experiment, named_model

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
    samples: Annotated[int, typer.Option(min=8, help="Groups of samples, a power of two.")] = 1024,
    out: Annotated[Path | None, typer.Option(help="Folder for sobol.json, sobol.png.")] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Sobol indices of the deterministic answer (G_s, a, Ca, a/l) over ranges of the inputs.

    Exit status: 0 done, 1 the ranges leave the database, 2 bad input.
    """
    from rich.console import Console

    from capsbayes.cli.paths import check_folder, filled
    from capsbayes.cli.printing import model_words, print_json, write_study, written_words
    from capsbayes.measurement import Measurement
    from capsbayes.plan import sobol_indices

    check_folder("--out", out)
    stated = _stated(ranges or [])
    measurement = Measurement.read(capsule)
    known = named_experiment(measurement, experiment)
    model = named_model(database, known.cross_section)
    with Console(stderr=True).status("Answering the samples ..."):
        study = sobol_indices(measurement, model, known, seed=seed, ranges=stated, samples=samples)
    if out is not None:
        from capsbayes.show import sobol_figure

        with filled(out) as folder:
            write_study(folder, "sobol", study.as_dict(), sobol_figure(study))
    if as_json:
        print_json(study.as_dict())
    else:
        from capsbayes.show.tables.plan import sobol_table
        from capsbayes.show.tables.table import print_parts

        model_line = model_words(study.model_name, study.model_sha256, study.seed)
        files = written_words(out, "sobol.json", "sobol.png")
        lines = [*_lines(study), model_line, files]
        print_parts(sobol_table(study), *lines, status=study.status, good=study.status.ok)
    if not study.status.ok:
        raise typer.Exit(1)


def _stated(texts: list[str]) -> dict[str, Quantity]:
    """Range of each option ``--range NAME=TEXT``."""
    from capsbayes.errors import InputError
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
