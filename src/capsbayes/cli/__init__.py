"""Command line: the same words as the library, one file a command.

A command's module is light to import; it reaches its floor of the package
only when the command runs, so that ``capsbayes --help`` stays fast.
"""

from __future__ import annotations

import importlib
import sys

import typer

from capsbayes.errors import CapsbayesError

app = typer.Typer(
    name="capsbayes",
    help="Shear modulus and radius of microcapsules from a picture, with honest credible intervals.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


for _name in (
    "simulate",
    "build",
    "rebuild",
    "validate",
    "measure",
    "identify",
    "batch",
    "population",
    "diagnose",
    "report",
    "atlas",
    "transient",
    "verify",
    "hide",
    "exam",
):
    app.command(_name)(getattr(importlib.import_module(f"capsbayes.cli.{_name}"), _name))
app.add_typer(importlib.import_module("capsbayes.cli.sensitivity").app, name="sensitivity")


def main() -> None:
    """Run the command line; a user's mistake ends as one line and exit status 2."""
    try:
        app()
    except CapsbayesError as error:
        typer.echo(f"capsbayes: {error}", err=True)
        sys.exit(2)
