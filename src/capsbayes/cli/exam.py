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
    only: Annotated[str | None, typer.Option(help="Only cells whose name contains this text.")] = None,
    sessions: Annotated[int | None, typer.Option(min=1, help="Of each cell, at most; all if absent.")] = None,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Draw many blind sessions with true effects, diagnose each, and write the page of the answers.

    With --effects, sessions of two sizes of each effect of the file are drawn as well, and all effects are tried in
    each session. Finished sessions are kept, so that the command can be stopped and run again. On two cores the
    shapes of a pool take three minutes, or twenty where the cross-section or the time varies; the sessions take about
    two hours. Exit status: 0 done, 2 bad input.
    """
    from dataclasses import replace

    from rich.console import Console

    from capsbayes.effects import catalogue
    from capsbayes.evidence.blind.pools import build_pools
    from capsbayes.evidence.exam.cells import cells_with
    from capsbayes.evidence.exam.examine import examine
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
    console = Console(stderr=True, quiet=not sys.stderr.isatty())
    build_pools(dict.fromkeys(cell.shapes for cell in chosen), pools, workers=workers)
    answers = examine(
        chosen, pools, out, workers=workers, tell=lambda line: console.print(line, highlight=False, markup=False)
    )
    write_file(out / "exam.md", exam_page(chosen, answers))
    if as_json:
        print_json({"file": str(out / "exam.md"), "cells": [cell.name for cell in chosen]})
    else:
        typer.echo(f"{out / 'exam.md'}")
