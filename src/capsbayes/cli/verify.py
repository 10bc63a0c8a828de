"""``capsbayes verify``: the simulator against theory, other codes and its own limits."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.options import AsJson
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Writes


def verify(
    out: Annotated[
        Path,
        typer.Option(help="Folder for results.jsonl, verification.md and its pictures."),
        Writes(within=("verification.md", "*.png")),
    ],
    only: Annotated[str | None, typer.Option(help="Name of the only topic to compute.")] = None,
    as_json: AsJson = False,
) -> None:
    """Compute every comparison that is not in the folder yet, and write the page.

    All of them take a quarter of an hour of one core; finished items are kept, so that the command can be stopped and
    run again. Exit status: 0 no target missed, 1 a target missed, 2 bad input.
    """
    from collections import Counter

    from rich.console import Console

    from capsbayes.evidence.verification import TOPICS
    from capsbayes.evidence.verification import verify as verified

    console = Console(stderr=True, quiet=not sys.stderr.isatty())
    tables = verified(TOPICS, out, only=only, tell=lambda line: console.print(line, highlight=False))
    total: Counter[str] = Counter()
    topics = {name: Counter(row.verdict for row in rows if row.verdict) for name, rows in tables.items()}
    for name, verdicts in topics.items():
        if not as_json:
            typer.echo(f"{name:20s} {', '.join(f'{count} {verdict}' for verdict, count in verdicts.items())}")
        total += verdicts
    if as_json:
        print_json({"file": str(out / "verification.md"), "verdicts": topics})
    else:
        typer.echo(f"{out / 'verification.md'}")
    if total["missed"]:
        raise typer.Exit(1)
