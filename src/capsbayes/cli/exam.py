"""``capsbayes exam``: diagnose blind sessions and write the page of the answers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.effects_file import EffectsFile, own_effects
from capsbayes.cli.options import AsJson, Workers
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError


def exam(
    out: Annotated[
        Path, typer.Option(help="Folder for the answers and the page exam.md."), Writes(within=("exam.md",))
    ],
    pools: Annotated[Path, typer.Option(help="Folder of the simulated shapes; missing ones are built."), Writes()],
    effects: EffectsFile = None,
    half: Annotated[str, typer.Option(help="Half of the sessions: development or locked.")] = "development",
    freeze_now: Annotated[
        bool, typer.Option("--freeze", help="Record the diagnosis as it is, which the locked half asks for.")
    ] = False,
    further_shapes: Annotated[
        bool, typer.Option("--further-shapes", help="Build all 600 plain shapes first: an hour on one core.")
    ] = False,
    only: Annotated[str | None, typer.Option(help="Only cells whose name contains this text.")] = None,
    sessions: Annotated[int | None, typer.Option(min=1, help="Of each cell, at most; all if absent.")] = None,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Draw blind sessions with hidden faults in laboratories drawn at random, diagnose each, and write the page.

    With --effects, sessions of two sizes of each effect of the file are drawn as well, and all effects are tried in
    each session. Finished sessions are kept, so that the command can be stopped and run again. The locked half has
    other seeds, and is opened only with the diagnosis that was recorded by --freeze. Exit status: 0 done, 2 bad input.
    """
    from dataclasses import replace
    from functools import partial

    from rich.console import Console

    from capsbayes.effects import catalogue
    from capsbayes.evidence.blind.pools import build_pools
    from capsbayes.evidence.exam.cells import HALVES, cells_with
    from capsbayes.evidence.exam.examine import examine, stored
    from capsbayes.evidence.exam.frozen import check_frozen, freeze
    from capsbayes.evidence.exam.page import exam_page
    from capsbayes.files.output_file import write_file
    from capsbayes.surrogate import Surrogate

    own = own_effects(effects, catalogue(), Surrogate.open("square-neo-hookean"))
    cells = cells_with(own.effects, own.sha256)
    chosen = [cell for cell in cells if only is None or only in cell.name]
    if not chosen:
        raise InputError("exam", "--only", f"part of one of {', '.join(cell.name for cell in cells)}", repr(only))
    if sessions is not None:
        chosen = [replace(cell, sessions=min(sessions, cell.sessions)) for cell in chosen]
    if half not in HALVES:
        raise InputError("exam", "--half", f"one of {', '.join(HALVES)}", repr(half))
    if freeze_now:
        freeze(out)
    if half == "locked":
        check_frozen(out)
    console = Console(stderr=True, quiet=not sys.stderr.isatty())
    build_pools(dict.fromkeys(cell.shapes for cell in chosen), pools, workers=workers, further=further_shapes)
    tell = partial(console.print, highlight=False, markup=False)
    examine(chosen, pools, out, half=half, workers=workers, tell=tell)
    answers = {name: stored(cells, pools, out, half=name) for name in HALVES}
    write_file(out / "exam.md", exam_page(cells, answers))
    if as_json:
        print_json({"file": str(out / "exam.md"), "cells": [cell.name for cell in chosen]})
    else:
        typer.echo(f"{out / 'exam.md'}")
