"""``capsbayes hide``: a blind set of measured capsules with a true effect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsbayes.cli.options import AsJson, Seed, Workers
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError
from capsbayes.files.output_file import together, write_file

if TYPE_CHECKING:
    from capsbayes.evidence.blind import BlindSession, TrueEffect


def hide(
    effect: Annotated[str, typer.Option(help="True effect, as pre-inflation, halo or none.")],
    out: Annotated[
        Path,
        typer.Option(help="Folder of the set; the truth goes into OUT.truth next to it."),
        Writes(next_to=("{name}.truth/",)),
    ],
    effect_size: Annotated[
        str, typer.Option(help="Size of the effect with its unit, as '0.03', '0.4 um' or '300 us'.")
    ] = "0",
    capsules: Annotated[int, typer.Option(min=1, max=10_000, help="Number of capsules.")] = 40,
    seed: Seed = 1,
    lengths_only: Annotated[bool, typer.Option("--lengths-only", help="Measure lengths alone, no outlines.")] = False,
    refinement: Annotated[int, typer.Option(min=4, max=32, help="Fineness n of the mesh.")] = 12,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a lab's capsules with a true effect, and measure them: a blind set for `diagnose`.

    A capsule takes about half a minute of one core. Finished shapes are kept, so that the command can be
    stopped and run again. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.evidence.blind import Lab, simulate_session, true_effect_named

    true_effect = true_effect_named(effect)
    value, truth = _size(true_effect, effect_size), out.with_name(f"{out.name}.truth")
    _check_empty(out)
    blind = simulate_session(
        true_effect,
        value,
        lab=Lab(),
        capsules=capsules,
        seed=seed,
        shapes=truth / "shapes.nc",
        outline=not lengths_only,
        refinement=refinement,
        workers=workers,
    )
    _write(blind, out, truth, as_json)


def _size(effect: TrueEffect, text: str) -> float:
    from capsbayes.quantity import Quantity

    if effect.name == "none":
        return 0.0
    example = {"m": "0.4 um", "s": "300 us", "s/m": "5 s/m"}.get(effect.unit, "0.03")
    read = Quantity.read(text, where="hide", key="--effect-size", units=(effect.unit,), example=example, signed=True)
    if read.error:
        raise InputError("hide", "--effect-size", f'a number without an error, as "{example}"', repr(text))
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
