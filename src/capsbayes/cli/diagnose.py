"""``capsbayes diagnose``: what a model misses in a set of capsules."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, ExperimentFile, ModelName, Seed, named_model

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from capsbayes.diagnosis import Session, Study, Verification
    from capsbayes.effect import Effect


def diagnose(
    capsules: Annotated[
        Path, typer.Argument(help="Folder of measurement files, .csv table of lengths, or .nc file of outlines.")
    ],
    out: Annotated[Path | None, typer.Option(help="Folder for study.html and study.json.")] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
    candidates: Annotated[
        str | None, typer.Option(help="Effects to try, as 'halo,exposure'; default: all that are known.")
    ] = None,
    measured: Annotated[
        list[str] | None,
        typer.Option(help="Size of an effect as measured apart from the capsules, as 'halo=0.35 +/- 0.05 um'."),
    ] = None,
    level: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Probability of finding a disagreement where there is none.")
    ] = 0.05,
    as_json: AsJson = False,
) -> None:
    """Find where capsules disagree with the model, name what would explain it, and try that on capsules held out.

    Exit status: 0 whatever the verdict, 2 on bad input.
    """
    import json

    from rich.console import Console

    from capsbayes.cli.paths import check_folder
    from capsbayes.diagnosis import Session, summary
    from capsbayes.diagnosis import diagnose as diagnosed
    from capsbayes.work.progress import progress_bar

    check_folder("--out", out)
    session = Session.read(capsules, experiment)
    cross_section = session.experiment.cross_section
    effects = _effects(candidates, cross_section)
    elsewhere = _measured(measured or [], effects)
    model = named_model(database, cross_section, _view(session))
    with progress_bar(None, "reading") as update:
        study = diagnosed(
            session,
            model,
            seed=seed,
            candidates=effects,
            level=level,
            measured=elsewhere,
            progress=lambda step, done, steps: update(done, step, steps),
        )
    if out is not None:
        _write(study, out)
    if as_json:
        typer.echo(json.dumps(summary(study), indent=2))
    else:
        _print(Console(highlight=False), study, out)


def _view(session: Session) -> str:
    """Return the view of the outlines of a session, the mid-plane if there are none."""
    from capsbayes.errors import InputError
    from capsbayes.measured_outline import MID_PLANE

    views = sorted({one.outline.view for one in session.measurements if one.outline is not None})
    if len(views) > 1:
        raise InputError("capsules", "outline.view", "outlines of one view", ", ".join(views))
    return views[0] if views else MID_PLANE


def _effects(names: str | None, cross_section: str) -> dict[str, Effect]:
    """Return the candidates named by parameter or effect, by default all that hold in this cross-section."""
    from capsbayes.cli.options import choose
    from capsbayes.effects import catalogue

    effects = catalogue(cross_section)
    if names is None:
        return effects
    known = _by_either_name(effects)
    chosen = [choose("diagnose", "--candidates", name.strip(), known) for name in names.split(",")]
    return {name: effects[name] for name in chosen}


def _by_either_name(effects: dict[str, Effect]) -> dict[str, str]:
    """Name of the parameter by that of the effect, and by itself."""
    return {one.name: name for name, one in effects.items()} | {name: name for name in effects}


def _measured(texts: list[str], effects: dict[str, Effect]) -> dict[str, tuple[float, float]]:
    """Size and standard error in SI of each ``NAME=VALUE +/- ERROR UNIT``."""
    from capsbayes.cli.options import choose
    from capsbayes.errors import InputError
    from capsbayes.quantity import Quantity

    known = _by_either_name(effects)
    found = {}
    for text in texts:
        label, _, stated = text.partition("=")
        name = choose("diagnose", "--measured", label.strip(), known)
        unit = effects[name].parameter.unit
        bare = "" if unit == "-" else unit
        example = f"0.3 +/- 0.1 {bare}".strip()
        read = Quantity.read(stated, where="--measured", key=name, units=(bare,), example=example, signed=True)
        if not read.error:
            raise InputError("--measured", name, f'a standard error, as in "{example}"', repr(stated))
        found[name] = read.value, read.error
    return found


def _write(study: Study, out: Path) -> None:
    """Write both files, or nothing."""
    import json

    from capsbayes.cli.paths import filled
    from capsbayes.diagnosis import summary
    from capsbayes.show import study_page

    with filled(out) as unfinished:
        (unfinished / "study.html").write_text(study_page(study), encoding="utf-8")
        (unfinished / "study.json").write_text(json.dumps(summary(study), indent=2) + "\n")


def _print(console: Console, study: Study, out: Path | None) -> None:
    from capsbayes.show import lengths_alone, verdict_sentence
    from capsbayes.show.study_words import deviation_words, modulus_words, p_value_words

    console.print(verdict_sentence(study), style="bold", markup=False)
    for words in (modulus_words(study), lengths_alone(study.session)):
        if words:
            console.print(words, markup=False)
    if study.session.left_out:
        console.print(f"{len(study.session.left_out)} capsules were left out:")
        for line in study.session.left_out:
            console.print(f"  {line}", markup=False)
    if study.finding.deviations:
        first = study.finding.deviations[0]
        console.print(
            f"Largest deviation: {first.name} {deviation_words(first)}, as large by chance "
            f"{p_value_words(first.p_value)}, in {study.finding.capsules} capsules.",
            markup=False,
        )
    if study.scores:
        console.print(_candidate_table(study))
    if study.verification is not None:
        console.print(_held_out(study.verification), markup=False)
        for line in _at_flow_rates(study.verification):
            console.print(line, markup=False)
    model = study.tested_model
    console.print(f"Model: {model.name}, sha256 {model.sha256[:12]}; seed {study.seed}.")
    if out is not None:
        console.print(f"Written to {out}: study.html, study.json.", markup=False)


def _candidate_table(study: Study) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.diagnosis import UNKNOWN
    from capsbayes.parameters import PARAMETERS
    from capsbayes.show.study_words import odds_words, size_words, told_words

    table = Table(title="Effects that were tried, the likeliest first", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.title_justify = "left"
    table.add_column("effect", no_wrap=True)
    table.add_column("ln ratio", justify="right", no_wrap=True)
    modulus = PARAMETERS["surface_shear_modulus"]
    for heading in ("size", f"median G_s {modulus.shown_unit}", "", "would be separated by"):
        table.add_column(heading)
    for name, one in study.scores.items():
        size = escape(f"{one.effect.parameter.symbol} = {size_words(one)}")
        median = f"{modulus.shown(one.modulus[one.best]):.1f}"
        told = told_words(study, name)
        ratio = f"{one.log_likelihood_ratio:.1f}"
        table.add_row(one.effect.name, ratio, size, median, told, escape(one.effect.separated_by))
    likeliest = max(study.evidence[name] for name in study.scores)
    table.caption = (
        "ln ratio: log-likelihood ratio of all capsules to the model without it; odds of what is not in this list "
        f"against the best of it: {odds_words(study.evidence[UNKNOWN] - likeliest)}"
    )
    table.caption_justify = "left"
    return table


def _held_out(verification: Verification) -> str:
    import math

    from capsbayes.parameters import PARAMETERS

    modulus = PARAMETERS["surface_shear_modulus"]
    before, after = (modulus.shown(one.median_modulus) for one in verification.comparisons)
    gaps = [1e6 * one.gap for one in verification.comparisons]
    gap = f"gap {gaps[0]:.3f} -> {gaps[1]:.3f} um, " if all(map(math.isfinite, gaps)) else ""
    p_values = verification.before.p_value, verification.after.p_value
    return (
        f"{len(verification.log_likelihood_ratios)} capsules held out, before -> after: {gap}p-value "
        f"{p_values[0]:.2g} -> {p_values[1]:.2g}, median G_s {before:.1f} -> {after:.1f} {modulus.shown_unit}; "
        f"log-likelihood ratio {verification.log_likelihood_ratio:+.2f} +/- {verification.error:.2f} a capsule."
    )


def _at_flow_rates(verification: Verification) -> Iterator[str]:
    """A line for each flow rate, if they are known."""
    from capsbayes.parameters import PARAMETERS

    modulus, flow_rate = PARAMETERS["surface_shear_modulus"], PARAMETERS["flow_rate"]
    before, after = (one.modulus_at_flow_rates for one in verification.comparisons)
    for rate, (count, median) in before.items():
        yield (
            f"  at {flow_rate.shown(rate):.3g} {flow_rate.shown_unit} ({count} capsules): median G_s "
            f"{modulus.shown(median):.1f} -> {modulus.shown(after[rate][1]):.1f} {modulus.shown_unit}"
        )
