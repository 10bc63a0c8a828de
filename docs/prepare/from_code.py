"""Take the quantities, statuses, effects, databases and the help of the commands for the pages from the code."""

from __future__ import annotations

import re

import typer
from keys import keys_table
from typer.cli import get_docs_for_click
from typer.main import get_command

from capsbayes import Database
from capsbayes.cli import app
from capsbayes.database import NO_EFFECT
from capsbayes.effects import catalogue
from capsbayes.model import Effect
from capsbayes.parameters import PARAMETERS
from capsbayes.report.numbers import unit_of
from capsbayes.status import Status

QUANTITIES, STATUSES = "<!-- table of quantities -->", "<!-- table of statuses -->"
EFFECTS, DATABASES = "<!-- table of effects -->", "<!-- table of databases -->"
COMMANDS = "reference/command-line.md"
SHORT_HELP = re.compile(r"\*\*Commands\*\*:.*?(?=^## )", re.DOTALL | re.MULTILINE)


def with_tables(markdown: str) -> str:
    """Replace the marks of a page by the tables."""
    for mark, table in ((QUANTITIES, _quantities), (STATUSES, _statuses), (EFFECTS, _effects), (DATABASES, _databases)):
        if mark in markdown:
            markdown = markdown.replace(mark, table())
    return markdown


def commands() -> str:
    """Return the help of all commands, without the list of their first lines, and the keys of what they print."""
    command = get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="capsbayes")
    return SHORT_HELP.sub("", text.replace("# `capsbayes`", "# Commands", 1)) + keys_table()


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


def _databases() -> str:
    """Return the table of the databases that come with the library."""
    head = "| database | membrane | values | a/l | Ca | shapes | refinement |\n" + "|---" * 7 + "|\n"
    return head + "\n".join(_database(name, Database.open(name)) for name in Database.shipped())


def _database(name: str, database: Database) -> str:
    shapes, values = database.converged, ""
    if database.effect != NO_EFFECT:
        values = f"${PARAMETERS[database.effect].latex}$ = " + ", ".join(f"{value:g}" for value in database.values)
    size, ca = (f"{shapes[of].min():g} to {shapes[of].max():g}" for of in ("size_ratio", "capillary_number"))
    law, refinement = database.dataset.attrs["law"], database.settings["refinement"]
    return f"| `{name}` | {law} | {values} | {size} | {ca} | {len(shapes)} | {refinement} |"
