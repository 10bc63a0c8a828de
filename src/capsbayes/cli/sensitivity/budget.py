"""``capsbayes sensitivity budget``: which input owns how much of the interval of one capsule."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, CapsuleFile, ExperimentFile, ModelName, Seed, named_experiment, named_model

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from capsbayes.plan import BudgetRow, ErrorBudget


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
    from capsbayes.cli.sensitivity.output import as_json as text_of
    from capsbayes.cli.sensitivity.output import write_study
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
    with Console(stderr=True).status("Working out the budget ..."):
        posterior = identify(measurement, model, known, engine="quadrature", seed=seed, prior=prior)
        found = error_budget(posterior, model)
    everything = {**found.as_dict(), "seed": seed}
    if out is not None:
        from capsbayes.show import budget_figure

        with filled(out) as folder:
            write_study(folder, "budget", everything, budget_figure(found))
            found.table().to_csv(folder / "budget.csv", index_label="input")
    if as_json:
        typer.echo(text_of(everything))
    else:
        _print(Console(highlight=False), found, out, seed)
    if not found.status.ok:
        raise typer.Exit(1)


def _print(console: Console, found: ErrorBudget, out: Path | None, seed: int) -> None:
    console.print(_table(found))
    for note in found.notes:
        console.print(note, markup=False)
    console.print(f"Model: {found.model_name}, sha256 {found.model_sha256[:12]}; seed {seed}.")
    if out is not None:
        console.print(f"Written to {out}: budget.json, budget.csv, budget.png.", markup=False)
    console.print(f"Status: {found.status}", style="green" if found.status.ok else "bold red")


def _table(found: ErrorBudget) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    modulus, radius = PARAMETERS["surface_shear_modulus"], PARAMETERS["capsule_radius"]
    values = ", ".join(
        f"{one.symbol} = {one.shown(found.value[one.name]):.4g} {one.shown_unit} +/- {100.0 * found.sd[one.name]:.2g} %"
        for one in (modulus, radius)
    )
    table = Table(title=f"Error budget: {values}", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.title_justify = "left"
    table.add_column("input", no_wrap=True)
    for one in (modulus, radius):
        for heading in ("share", "slope", "change"):
            table.add_column(f"{one.symbol}\n{heading}", justify="right", no_wrap=True)
    for row in found.rows:
        table.add_row(
            escape(_input(row)), *_cells(row, modulus.name, modulus.scale), *_cells(row, radius.name, radius.scale)
        )
    table.caption = (
        f"share: of the variance of the logarithm; slope: d ln / d ln of the input; change: with one standard "
        f"error of the input, in {modulus.shown_unit} and {radius.shown_unit}"
    )
    table.caption_justify = "left"
    return table


def _input(row: BudgetRow) -> str:
    """An input with its value and error in the unit people read."""
    if row.setting is None:
        return row.words
    from capsbayes.parameters import PARAMETERS

    one, setting = PARAMETERS[row.name], row.setting
    scale, unit = (1.0, "l") if setting.unit == "l" else (one.scale, one.shown_unit)
    if setting.unit == "m":
        scale, unit = 1e6, "um"
    error = f" +/- {scale * setting.error:.2g}" if setting.error else ""
    return f"{one.symbol} = {scale * setting.value:.4g}{error} {unit}"


def _cells(row: BudgetRow, quantity: str, scale: float) -> list[str]:
    slope = row.log_slope.get(quantity)
    change = row.change.get(quantity)
    return [
        f"{100.0 * row.share[quantity]:.1f} %",
        "" if slope is None else f"{slope:+.3f}",
        "" if change is None else f"{scale * change:+.3g}",
    ]
