"""``capsbayes identify``: from a measured capsule to its shear modulus and radius."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from capsbayes.inference import Posterior
    from capsbayes.measurement import Measurement


def identify(
    capsule: Annotated[
        Path, typer.Argument(help="TOML file of the capsule: lengths, velocity, its experiment's file.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for posterior.nc, summary.json, corner.png and outline.png.")
    ] = None,
    experiment: Annotated[
        Path | None, typer.Option(help="TOML file of the experiment; default: the one the capsule's file names.")
    ] = None,
    database: Annotated[
        str | None,
        typer.Option(help="Name of a shipped database, or path of a .nc file; default: neo-Hookean, same section."),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            help="Prior of the further coordinate of the database, as pre_inflation='0 .. 0.1' (uniform) or "
            "pre_inflation='0.03 +/- 0.01'; default: uniform over the database."
        ),
    ] = None,
    engine: Annotated[
        str | None, typer.Option(help="emcee or quadrature; default: emcee, checked by quadrature.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all randomness; stored in the results.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Identify one capsule: posterior of the shear modulus of its membrane and of its radius."""
    import json

    from capsbayes.experiment import Experiment
    from capsbayes.inference import Prior
    from capsbayes.inference import identify as identified
    from capsbayes.measured_outline import SECTION
    from capsbayes.measurement import Measurement
    from capsbayes.surrogate import Surrogate

    _check_folder(out)
    measurement = Measurement.read(capsule)
    believed = Prior.read(capsule).with_coordinates(_coordinates(prior or []), where="--prior")
    known = Experiment.read(experiment or _named(measurement))
    view = SECTION if measurement.outline is None else measurement.outline.view
    model = Surrogate.open(database or f"{known.section}-neo-hookean", view=view)
    posterior = identified(measurement, model, known, engine=engine or "emcee", seed=seed, prior=believed)
    if out is not None:
        _write(posterior, out)
    if as_json:
        typer.echo(json.dumps(posterior.as_dict(), indent=2))
    else:
        _print(posterior, out)
    if not posterior.status.ok:
        raise typer.Exit(1)


def _coordinates(priors: list[str]) -> dict[str, str]:
    """Name and text of each option ``--prior NAME=TEXT``."""
    from capsbayes.errors import InputError
    from capsbayes.parameters import COORDINATES

    texts = {}
    for prior in priors:
        name, equals, text = prior.partition("=")
        if name not in COORDINATES or not equals:
            raise InputError("--prior", "", f"NAME=TEXT with one of the names {', '.join(COORDINATES)}", repr(prior))
        texts[name] = text
    return texts


def _named(measurement: Measurement) -> Path:
    from capsbayes.errors import InputError

    if measurement.experiment_file is None:
        raise InputError(
            measurement.source, "experiment", "the name of a file", "nothing", "name it, or use --experiment"
        )
    return measurement.experiment_file


def _check_folder(out: Path | None) -> None:
    """Refuse a folder that cannot be made before any work is done."""
    from capsbayes.errors import InputError

    if out is not None and out.exists() and not out.is_dir():
        raise InputError("--out", "", "a folder", f"the file {out}")


def _write(posterior: Posterior, out: Path) -> None:
    """Write all results into a folder beside, then move them: an error leaves nothing half done."""
    import json
    import os
    import tempfile

    from capsbayes.report import corner_plot, outline_figure
    from capsbayes.report.corner_plot import SHOWN

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".unfinished-") as folder:
        unfinished = Path(folder)
        posterior.write(unfinished / "posterior.nc")
        (unfinished / "summary.json").write_text(json.dumps(posterior.as_dict(), indent=2) + "\n")
        corner_plot(posterior, (*SHOWN, *posterior.prior.coordinates)).savefig(unfinished / "corner.png", dpi=110)
        if posterior.outlines is not None:
            outline_figure(posterior).savefig(unfinished / "outline.png", dpi=140)
        for made in sorted(unfinished.iterdir()):
            os.replace(made, out / made.name)


def _print(posterior: Posterior, out: Path | None) -> None:
    from rich.console import Console

    from capsbayes.inference.checks import LEANING_SHARE

    console = Console(highlight=False)
    console.print(_quantities(posterior))
    console.print(_shares(posterior))
    if posterior.agreement is not None:
        console.print(f"emcee and quadrature: {posterior.agreement}.")
    failed = [str(gate) for gate in posterior.gates if not gate.passed]
    passed = f"{len(posterior.gates) - len(failed)} of {len(posterior.gates)} gates passed"
    console.print(f"Gates: {passed}{': ' + '; '.join(failed) if failed else ''}.")
    for border, share in posterior.leaning.items():
        if share > LEANING_SHARE:
            console.print(f"{share:.0%} of the posterior lies next to the border of the {border}.")
    prior = posterior.prior
    console.print(
        f"Priors: G_s {prior.surface_shear_modulus.shape} from {1e3 * prior.surface_shear_modulus.low:g} to "
        f"{1e3 * prior.surface_shear_modulus.high:g} mN/m, a {prior.capsule_radius.shape} from "
        f"{1e6 * prior.capsule_radius.low:g} to {1e6 * prior.capsule_radius.high:g} um"
        f"{''.join(map(_as_text, prior.coordinates.items()))}."
    )
    console.print(f"Model: {posterior.model_name}, sha256 {posterior.model_sha256[:12]}; seed {posterior.seed}.")
    if out is not None:
        console.print(f"Written to {out}: posterior.nc, summary.json, corner.png, outline.png.")
    console.print(f"Status: {posterior.status}", style="green" if posterior.status.ok else "bold red")


def _as_text(coordinate: tuple[str, Any]) -> str:
    from capsbayes.parameters import PARAMETERS

    name, distribution = coordinate
    low, high = distribution.ppf([0.025, 0.975])
    return f", {PARAMETERS[name].symbol} {distribution.dist.name}, 95 % from {low:.3g} to {high:.3g}"


def _quantities(posterior: Posterior) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    table = Table(
        title=f"Posterior by {posterior.engine}: median and equal-tailed intervals",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.title_justify = "left"
    table.add_column("", no_wrap=True)
    others = ["quadrature"] if posterior.reference else []
    for heading in ("median", "68 %", "95 %", *others, "paper"):
        table.add_column(heading, justify="right", no_wrap=True)
    paper = posterior.deterministic.as_dict() if posterior.deterministic else {}
    for name, marginal in posterior.marginals.items():
        one = PARAMETERS[name]
        digits = _digits(marginal.sd * one.scale)
        values = [
            (marginal.median,),
            (marginal.lower_68, marginal.upper_68),
            (marginal.lower_95, marginal.upper_95),
            *([(posterior.reference[name].median,)] if others else []),
            *([(paper[name],)] if name in paper else []),
        ]
        shown = ["..".join(f"{one.scale * value:.{digits}f}" for value in group) for group in values]
        table.add_row(escape(one.label), *shown)
    return table


def _digits(error: float) -> int:
    """Decimals that show two digits of an error."""
    import math

    return max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 3


def _shares(posterior: Posterior) -> Table:
    from rich import box
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    table = Table(title="Share of the variance of log G_s owed to each input", box=box.SIMPLE_HEAD, show_header=False)
    table.title_justify = "left"
    table.add_column("")
    table.add_column("share", justify="right")
    for name, share in posterior.shares.items():
        one = PARAMETERS.get(name)
        table.add_row(f"{one.symbol}, {one.meaning}" if one else name, f"{100.0 * share:.1f} %")
    return table
