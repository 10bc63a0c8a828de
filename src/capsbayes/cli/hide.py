"""``capsbayes hide``: a blind set of measured capsules with a true effect."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.effects_file import EffectsFile, own_effects
from capsbayes.cli.options import AsJson, Seed, Workers
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError
from capsbayes.files.output_file import together, write_file

_LARGEST = {"m": 1e-4, "s": 0.1, "s/m": 1e3}  # size of an effect by its unit; of a ratio 10

if TYPE_CHECKING:
    from capsbayes.diagnosis.blind import BlindSession, TrueEffect


def hide(
    effect: Annotated[str, typer.Option(help="True effect, as pre-inflation, halo, none, or one of --effects.")],
    out: Annotated[
        Path,
        typer.Option(help="Folder of the set; the truth goes into OUT.truth next to it."),
        Writes(next_to=("{name}.truth/",)),
    ],
    effect_size: Annotated[
        str, typer.Option(help="Size of the effect with its unit, as '0.03', '0.4 um' or '300 us'.")
    ] = "0",
    effects: EffectsFile = None,
    shapes: Annotated[
        Path | None,
        typer.Option(help="Database of simulated shapes from which capsules are drawn; default: each is simulated."),
        Reads(),
    ] = None,
    capsules: Annotated[int, typer.Option(min=1, max=10_000, help="Number of capsules.")] = 40,
    seed: Seed = 1,
    flow_rate_error: Annotated[
        float | None,
        typer.Option(min=0.0, max=0.5, help="Relative standard error of the flow rates; default: none are stated."),
    ] = None,
    lengths_only: Annotated[bool, typer.Option("--lengths-only", help="Measure lengths alone, no outlines.")] = False,
    refinement: Annotated[int, typer.Option(min=4, max=32, help="Fineness n of the mesh.")] = 12,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a lab's capsules with a true effect, and measure them: a blind set for `diagnose`.

    A capsule takes about half a minute of one core, or nothing with --shapes. Finished shapes are kept, so that
    the command can be stopped and run again. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.diagnosis.blind import Lab, draw_session, read_shapes, simulate_session

    true_effect = _true_effect(effect, effects)
    value, truth = _size(true_effect, effect_size), out.with_name(f"{out.name}.truth")
    _check_empty(out)
    drawn = partial(
        draw_session, lab=Lab(flow_rate_error=flow_rate_error), capsules=capsules, seed=seed, outline=not lengths_only
    )
    if shapes is not None:
        blind = drawn(read_shapes(shapes, true_effect, value), true_effect, value)
    else:
        blind = simulate_session(
            true_effect,
            value,
            **drawn.keywords,
            shapes=truth / "shapes.nc",
            refinement=refinement,
            workers=workers,
        )
    _write(blind, out, truth, as_json)


def _true_effect(name: str, effects: Path | None) -> TrueEffect:
    """Return the true effect of a name, which may be that of a parameter of the file of effects."""
    from capsbayes.diagnosis.blind import true_effect_named, true_effect_of
    from capsbayes.effects import catalogue
    from capsbayes.surrogate import Surrogate

    if effects is None:
        return true_effect_named(name)
    own = own_effects(effects, catalogue(), Surrogate.open("square-neo-hookean")).effects
    return true_effect_named(name, {parameter.lower(): true_effect_of(effect) for parameter, effect in own.items()})


def _size(effect: TrueEffect, text: str) -> float:
    from capsbayes.quantity import Quantity

    example = {"m": "0.4 um", "s": "300 us", "s/m": "5 s/m"}.get(effect.unit, "0.03")
    if effect.name == "none" and text.strip() != "0":
        raise InputError("hide", "--effect-size", "nothing with --effect none", repr(text))
    read = Quantity.read(text, where="hide", key="--effect-size", units=(effect.unit,), example=example, signed=True)
    if read.error:
        raise InputError("hide", "--effect-size", f'a number without an error, as "{example}"', repr(text))
    if abs(read.value) > (most := _LARGEST.get(effect.unit, 10.0)):
        expected = f"a size of at most {most:g} {effect.unit}".rstrip()
        raise InputError("hide", "--effect-size", expected, repr(text), f'write it as "{example}"')
    return read.value


def _check_empty(out: Path) -> None:
    """Refuse a folder that holds something else before any work is done."""
    if out.exists() and any(out.iterdir()):
        raise InputError("--out", "", "an empty folder, or none", f"{out}, which holds files", "name another")


@together()
def _write(blind: BlindSession, out: Path, truth: Path, as_json: bool) -> None:
    """Write the set, and next to it the truth; the set holds the truth's hash, so that it cannot be changed later."""
    import hashlib
    import json

    told = json.dumps(blind.truth(), indent=1) + "\n"
    write_file(truth / "truth.json", told)
    blind.session.write(out)
    seal = hashlib.sha256(told.encode()).hexdigest()
    write_file(out / "seal.txt", f"sha256 of the truth: {seal}\n")
    if as_json:
        print_json(
            {"folder": str(out), "capsules": len(blind.session), "truth": str(truth / "truth.json"), "sha256": seal}
        )
        return
    typer.echo(f"{out}: {len(blind.session)} capsules; the truth is in {truth / 'truth.json'}, sealed by {seal[:12]}")
