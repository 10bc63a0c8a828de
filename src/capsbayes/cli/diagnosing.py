"""Commands about what the model misses: the diagnosis of a set of capsules, and blind sets that try it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import capsbayes as cb
from capsbayes.cli.command import Option, Reads, Writes, command, results
from capsbayes.cli.effects_file import EffectsFile, own_effects
from capsbayes.cli.options import CapsulesFile, ExperimentFile, ModelName, Seed, Workers, named_model
from capsbayes.cli.output import conclude, tell
from capsbayes.errors import InputError
from capsbayes.files.output_file import together, write_file
from capsbayes.quantity import uncertain
from capsbayes.report.files import Writer, json_file
from capsbayes.report.numbers import counted

if TYPE_CHECKING:
    from capsbayes.diagnosis.blind import TrueEffect
    from capsbayes.model import Effect

_SIZES = {"m": ("0.4 um", 1e-4), "s": ("300 us", 0.1), "s/m": ("5 s/m", 1e3)}
"""Example and largest size of an effect by its unit."""


@command
def diagnose(
    capsules: CapsulesFile,
    out: Annotated[Path | None, results("study.html", "study.json")] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
    effects: EffectsFile = None,
    candidates: Annotated[
        str | None, Option("Effects to try, as 'halo,exposure'; default: all that are known.")
    ] = None,
    invariance: Annotated[
        bool, Option("Try no effects: ask only where, and whether G_s is the same at all velocities and sizes.")
    ] = False,
    measured: Annotated[
        list[str] | None, Option("Size of an effect as measured apart from the capsules, as 'halo=0.35 +/- 0.05 um'.")
    ] = None,
    level: Annotated[
        float, Option("Probability of finding a disagreement where there is none.", min=0.0, max=1.0)
    ] = 0.01,
) -> None:
    """Find where capsules disagree with the model, name what would explain it, and test that on held-out capsules.

    With --out, a run that was interrupted goes on where it was when it is started again.

    Exit status: 0 whatever the verdict, 2 on bad input.
    """
    from capsbayes.diagnosis import summary
    from capsbayes.report import study_page
    from capsbayes.report.study import study_parts
    from capsbayes.run import progress_bar, resumable

    if invariance and (of_effects := [each for each in (candidates, effects, *(measured or [])) if each is not None]):
        expected = "no --candidates, --effects or --measured beside it: no effect is tried"
        raise InputError("diagnose", "--invariance", expected, ", ".join(map(str, of_effects)))
    session = cb.Session.read(capsules, experiment)
    cross_section = session.experiment.cross_section
    known, model = cb.effects.catalogue(cross_section), named_model(database, cross_section, _view(session))
    own = own_effects(effects, known, model)
    tried: Mapping[str, Effect] = {} if invariance else {**known, **own.effects}
    if candidates is not None:
        chosen = [_parameter_of("--candidates", name, tried) for name in candidates.split(",")]
        tried = {name: tried[name] for name in chosen}
    how: dict[str, Any] = {"candidates": tried, "measured": _measured(measured or [], tried), "level": level}
    with resumable(out, own.sha256):
        with progress_bar(None, "reading") as update:
            how["progress"] = lambda step, done, steps: update(done, step, steps)
            study = cb.diagnose(session, model, seed=seed, **how)
        result = {**summary(study), **own.described}
        files: dict[str, Writer] = {
            "study.html": lambda path: write_file(path, study_page(study)),
            "study.json": json_file(result),
        }
        conclude(result, study_parts(study), files, out=out)


def _view(session: cb.Session) -> str:
    """Return the view of the outlines of a session, the mid-plane if there are none."""
    from capsbayes.measurement import MID_PLANE

    views = sorted({each.outline.view for each in session.measurements if each.outline is not None})
    if len(views) > 1:
        raise InputError("capsules", "outline.view", "outlines of one view", ", ".join(views))
    return views[0] if views else MID_PLANE


def _parameter_of(option: str, name: str, effects: Mapping[str, Effect]) -> str:
    """Return the name of the parameter of an effect, of which either name is given; refuse one that is not known."""
    known = {effect.name: parameter for parameter, effect in effects.items()} | {each: each for each in effects}
    if name.strip() not in known:
        raise InputError("diagnose", option, f"one of {', '.join(known)}", repr(name.strip()))
    return known[name.strip()]


def _measured(texts: list[str], effects: Mapping[str, Effect]) -> dict[str, tuple[float, float]]:
    """Return the size and standard error in SI of each ``NAME=VALUE +/- ERROR UNIT``."""
    sizes = {}
    for text in texts:
        label, _, stated = text.partition("=")
        name = _parameter_of("--measured", label, effects)
        unit = effects[name].parameter.unit
        bare = "" if unit == "-" else unit
        example = f"0.3 +/- 0.1 {bare}".strip()
        read = uncertain(
            stated, where="--measured", key=name, units=(bare,), example=example, signed=True, normal=False
        )
        sizes[name] = read.value, read.error
    return sizes


@command
def hide(
    effect: Annotated[str, Option("True effect, as pre-inflation, halo, none, or one of --effects.")],
    out: Annotated[
        Path, Writes("Folder of the set; the truth goes into OUT.truth next to it.", next_to=("{name}.truth/",))
    ],
    effect_size: Annotated[str, Option("Size of the effect with its unit, as '0.03', '0.4 um' or '300 us'.")] = "0",
    effects: EffectsFile = None,
    shapes: Annotated[
        Path | None, Reads("Database of simulated shapes from which capsules are drawn; default: each is simulated.")
    ] = None,
    capsules: Annotated[int, Option("Number of capsules.", min=1, max=10_000)] = 40,
    seed: Seed = 1,
    flow_rate_error: Annotated[
        float | None, Option("Relative standard error of the flow rates; default: none are stated.", min=0.0, max=0.5)
    ] = None,
    lengths_only: Annotated[bool, Option("Measure lengths alone, no outlines.", "--lengths-only")] = False,
    refinement: Annotated[int, Option("Fineness n of the mesh.", min=4, max=32)] = 12,
    workers: Workers = None,
) -> None:
    """Simulate a lab's capsules with a true effect, and measure them: a blind set for `diagnose`.

    A capsule takes about half a minute of one core, or nothing with --shapes. Finished shapes are kept, so that
    the command can be stopped and run again. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.diagnosis import blind

    own: dict[str, TrueEffect] = {}
    if effects is not None:
        found = own_effects(effects, cb.effects.catalogue(), cb.Surrogate.open("square-neo-hookean")).effects
        own = {parameter.lower(): blind.true_effect_of(each) for parameter, each in found.items()}
    true_effect = blind.true_effect_named(effect, own)
    value, truth = _size(true_effect, effect_size), out.with_name(f"{out.name}.truth")
    if out.exists() and any(out.iterdir()):
        raise InputError("--out", "", "an empty folder, or none", f"{out}, which holds files", "name another")
    how: dict[str, Any] = {"lab": blind.Lab(flow_rate_error=flow_rate_error), "capsules": capsules, "seed": seed}
    how["outline"] = not lengths_only
    if shapes is not None:
        hidden = blind.draw_session(blind.read_shapes(shapes, true_effect, value), true_effect, value, **how)
    else:
        how |= {"shapes": truth / "shapes.nc", "refinement": refinement, "workers": workers}
        hidden = blind.simulate_session(true_effect, value, **how)
    with together():  # the set holds the hash of the truth, so that it cannot be changed later
        content = json.dumps(hidden.truth(), indent=1) + "\n"
        file = write_file(truth / "truth.json", content)
        hidden.session.write(out)
        seal = hashlib.sha256(content.encode()).hexdigest()
        write_file(out / "seal.txt", f"sha256 of the truth: {seal}\n")
    count = len(hidden.session)
    told = {"folder": str(out), "capsules": count, "truth": str(file), "sha256": seal}
    tell(told, f"{out}: {counted(count, 'capsule')}; the truth is in {file}, sealed by {seal[:12]}")


def _size(effect: TrueEffect, text: str) -> float:
    example, most = _SIZES.get(effect.unit, ("0.03", 10.0))
    if effect.name == "none" and text.strip() != "0":
        raise InputError("hide", "--effect-size", "nothing with --effect none", repr(text))
    read = cb.Quantity.read(text, where="hide", key="--effect-size", units=(effect.unit,), example=example, signed=True)
    if read.error:
        raise InputError("hide", "--effect-size", f'a number without an error, as "{example}"', repr(text))
    if abs(read.value) > most:
        expected = f"a size of at most {most:g} {effect.unit}".rstrip()
        raise InputError("hide", "--effect-size", expected, repr(text), f'write it as "{example}"')
    return read.value
