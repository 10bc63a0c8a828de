"""Take the quantities, the statuses, the effects and the help of the commands for the pages from the code."""

from __future__ import annotations

import re

import typer
from typer.cli import get_docs_for_click
from typer.main import get_command

from capsbayes.cli import app
from capsbayes.effects import catalogue
from capsbayes.model import Effect
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import unit_of
from capsbayes.status import Status

QUANTITIES, STATUSES = "<!-- table of quantities -->", "<!-- table of statuses -->"
EFFECTS = "<!-- table of effects -->"
COMMANDS = "reference/command-line.md"
SHORT_HELP = re.compile(r"\*\*Commands\*\*:.*?(?=^## )", re.DOTALL | re.MULTILINE)


def with_tables(markdown: str) -> str:
    """Replace the marks of a page by the tables."""
    for mark, table in ((QUANTITIES, _quantities), (STATUSES, _statuses), (EFFECTS, _effects)):
        if mark in markdown:
            markdown = markdown.replace(mark, table())
    return markdown


def commands() -> str:
    """Return the help of all commands, without the list of their first lines."""
    command = get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="capsbayes")
    return SHORT_HELP.sub("", text.replace("# `capsbayes`", "# Commands", 1))


def _quantities() -> str:
    """Return the table of `capsbayes.parameters`."""
    head = "| symbol | name | stored in | shown in | meaning |\n|---|---|---|---|---|\n"
    rows = (
        f"| ${known.latex}$ | `{known.name}` | {known.unit} | {known.shown_unit} | {known.meaning} |"
        for known in PARAMETERS.values()
    )
    return head + "\n".join(rows)


def _statuses() -> str:
    """Return the table of `capsbayes.Status`."""
    return "| in files | meaning |\n|---|---|\n" + "\n".join(
        f"| `{status.name}` | {status.value} |" for status in Status
    )


def _effects() -> str:
    """Return the table of `capsbayes.effects.catalogue`."""
    head = (
        "| effect | name | size | 95 % of the prior | what it changes | what would distinguish it |\n"
        + "|---" * 6
        + "|\n"
    )
    return head + "\n".join(_effect(effect) for effect in catalogue().values())


def _effect(effect: Effect) -> str:
    known = effect.parameter
    low, high = (f"{known.shown(value):.3g}" for value in effect.prior.ppf([0.025, 0.975]))
    size = f"${known.latex}$, {known.meaning}"
    reach = f"{low} to {high}{unit_of(known)}"
    return f"| {effect.name} | `{known.name}` | {size} | {reach} | {effect.changes} | {effect.separated_by} |"
