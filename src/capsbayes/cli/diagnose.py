"""``capsbayes diagnose``: what a model misses in a set of capsules."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.effects_file import EffectsFile, own_effects
from capsbayes.cli.options import AsJson, ExperimentFile, ModelName, Seed, choose, named_model
from capsbayes.cli.output import conclude
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError
from capsbayes.files.output_file import write_file
from capsbayes.report.files import Writer, json_file

if TYPE_CHECKING:
    from capsbayes.diagnosis import Session
    from capsbayes.model import Effect


def diagnose(
    capsules: Annotated[
        Path,
        typer.Argument(help="Folder of measurement files, .csv table of lengths, or .nc file of outlines."),
        Reads(),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for study.html and study.json."),
        Writes(within=("study.html", "study.json")),
    ] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
    effects: EffectsFile = None,
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
    """Find where capsules disagree with the model, name what would explain it, and test that on held-out capsules.

    With --out, a run that was interrupted goes on where it was when it is started again.

    Exit status: 0 whatever the verdict, 2 on bad input.
    """
    from capsbayes.diagnosis import Session, summary
    from capsbayes.diagnosis import diagnose as diagnosed
    from capsbayes.effects import catalogue
    from capsbayes.report import study_page
    from capsbayes.report.study import study_parts
    from capsbayes.run import progress_bar, resumable

    session = Session.read(capsules, experiment)
    cross_section = session.experiment.cross_section
    known = catalogue(cross_section)
    model = named_model(database, cross_section, _view(session))
    own = own_effects(effects, known, model)
    tried = _chosen(candidates, {**known, **own.effects})
    elsewhere = _measured(measured or [], tried)
    with resumable(out, own.sha256):
        with progress_bar(None, "reading") as update:
            study = diagnosed(
                session,
                model,
                seed=seed,
                candidates=tried,
                level=level,
                measured=elsewhere,
                progress=lambda step, done, steps: update(done, step, steps),
            )
        result = summary(study) | own.described
        files: dict[str, Writer] = {
            "study.html": lambda path: write_file(path, study_page(study)),
            "study.json": json_file(result),
        }
        conclude(result, lambda: list(study_parts(study)), files, out=out, as_json=as_json)


def _view(session: Session) -> str:
    """Return the view of the outlines of a session, the mid-plane if there are none."""
    from capsbayes.measurement import MID_PLANE

    outlines = (measurement.outline for measurement in session.measurements)
    views = sorted({outline.view for outline in outlines if outline is not None})
    if len(views) > 1:
        raise InputError("capsules", "outline.view", "outlines of one view", ", ".join(views))
    return views[0] if views else MID_PLANE


def _chosen(names: str | None, effects: dict[str, Effect]) -> dict[str, Effect]:
    """Return the candidates named by parameter or effect, by default all."""
    if names is None:
        return effects
    known = _by_either_name(effects)
    chosen = [choose("diagnose", "--candidates", name.strip(), known) for name in names.split(",")]
    return {name: effects[name] for name in chosen}


def _by_either_name(effects: dict[str, Effect]) -> dict[str, str]:
    """Return the name of each parameter by that of its effect, and by itself."""
    return {effect.name: name for name, effect in effects.items()} | {name: name for name in effects}


def _measured(texts: list[str], effects: dict[str, Effect]) -> dict[str, tuple[float, float]]:
    """Return the size and standard error in SI of each ``NAME=VALUE +/- ERROR UNIT``."""
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
