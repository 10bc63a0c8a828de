"""``capsbayes sensitivity sobol``: which input, varied over its range, moves the answer how much."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, CapsuleFile, ExperimentFile, ModelName, Seed, named_experiment, named_model

if TYPE_CHECKING:
    from rich.table import Table

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
    from capsbayes.cli.sensitivity.output import as_json as text_of
    from capsbayes.cli.sensitivity.output import write_study
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
        typer.echo(text_of(study.as_dict()))
    else:
        console = Console(highlight=False)
        console.print(_table(study))
        for line in _lines(study):
            console.print(line, markup=False)
        if out is not None:
            console.print(f"Written to {out}: sobol.json, sobol.png.", markup=False)
        console.print(f"Status: {study.status}", style="green" if study.status.ok else "bold red")
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


def _table(study: SobolStudy) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    table = Table(title="Sobol indices: alone, and with others", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.title_justify = "left"
    table.add_column("input", no_wrap=True)
    for answer in study.indices:
        table.add_column(escape(PARAMETERS[answer].symbol), justify="right", no_wrap=True)
    for name, stated in study.ranges.items():
        cells = [f"{one[name].first:.2f}, {one[name].total:.2f}" for one in study.indices.values()]
        table.add_row(escape(f"{PARAMETERS[name].symbol} = {stated.shown(name)}"), *cells)
    errors = [max(max(one.first_error, one.total_error) for one in found.values()) for found in study.indices.values()]
    table.add_row("95 %, at most", *(f"+/- {error:.2f}" for error in errors))
    return table


def _lines(study: SobolStudy) -> list[str]:
    lines = [f"{study.samples} samples in {study.groups} groups."]
    if study.outside:
        share = study.outside / study.samples
        lines.append(
            f"{study.outside} of them ({share:.1%}) have a shape that no capsule of the database has; they were given "
            f"the answer of the nearest shape. Without their groups the indices of G_s and a change by at most "
            f"{study.change:.3f}."
        )
    lines += study.notes
    return [*lines, f"Model: {study.model_name}, sha256 {study.model_sha256[:12]}; seed {study.seed}."]
