"""Command line: the same words as the library, one file or folder a command, options declared once in `options`.

A command's module is light to import; it reaches its floor of the package
only when the command runs, so that ``capsbayes --help`` stays fast.
"""

from __future__ import annotations

import importlib
import shlex
import sys
from typing import Annotated, Any

import typer

from capsbayes import __version__
from capsbayes.errors import CapsbayesError
from capsbayes.interruption import Interrupted, interruptible

UsageError: Any = typer.BadParameter.__bases__[0]  # of click, which newer versions of typer carry within themselves

COMMANDS = {
    "Measure and identify": ("measure", "identify", "report"),
    "Many capsules": ("batch", "population"),
    "What the model misses": ("diagnose",),
    "Plan measurements": ("sensitivity",),
    "Simulate and build": ("simulate", "transient", "build", "rebuild", "atlas"),
    "Evidence": ("validate", "verify", "hide", "exam"),
}

app = typer.Typer(
    name="capsbayes",
    help="Shear modulus and radius of microcapsules from a picture, with honest credible intervals.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"capsbayes {__version__}")
        raise typer.Exit


@app.callback()
def _version(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


for _group, _names in COMMANDS.items():
    for _name in _names:
        _module = importlib.import_module(f"capsbayes.cli.{_name}")
        if _name == "sensitivity":
            app.add_typer(_module.app, name=_name, rich_help_panel=_group)
        else:
            app.command(_name, rich_help_panel=_group)(getattr(_module, _name))


def main() -> None:
    """Run the command line; a user's mistake ends as one line and exit status 2, an interruption as one line too."""
    try:
        with interruptible():
            sys.exit(app(prog_name="capsbayes", standalone_mode=False) or 0)
    except Interrupted as error:
        kept = "; ".join(getattr(error, "__notes__", ["nothing is kept"]))
        command = shlex.join(["capsbayes", *sys.argv[1:]])
        typer.echo(f"capsbayes: interrupted; {kept}; to go on: {command}", err=True)
        sys.exit(error.exit_status)
    except CapsbayesError as error:
        typer.echo(f"capsbayes: {error}", err=True)
        sys.exit(2)
    except UsageError as error:
        command = error.ctx.command_path if error.ctx else "capsbayes"
        if error.format_message():  # not where the help was shown for want of a command
            typer.echo(f"{command}: {error.format_message()} (see {command} --help)", err=True)
        sys.exit(2)
    except typer.Abort:
        typer.echo("capsbayes: interrupted", err=True)
        sys.exit(130)
