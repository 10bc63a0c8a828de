"""Command line: the same words as the library, one file a group of commands, shared options declared in `options`.

A command reaches its floor of the package only when it runs, so that ``capsbayes --help`` stays fast.
"""

from __future__ import annotations

import os
import shlex
import sys
import warnings
from typing import Annotated, Any, NoReturn

import typer

from capsbayes import __version__
from capsbayes.cli import planning
from capsbayes.cli.diagnosing import diagnose, hide
from capsbayes.cli.many_capsules import batch, membrane, population
from capsbayes.cli.measuring import measure
from capsbayes.cli.one_capsule import bench, identify, report
from capsbayes.cli.simulating import atlas, build, simulate, transient, validate
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.interruption import Interrupted, interruptible

UsageError: Any = typer.BadParameter.__bases__[0]  # of click, which newer versions of typer carry within themselves

_LONGEST = 1000  # characters of a message

COMMANDS: dict[str, dict[str, Any]] = {
    "Measure and identify": {"app": bench, "measure": measure, "identify": identify, "report": report},
    "Many capsules": {"batch": batch, "population": population, "membrane": membrane},
    "What the model misses": {"diagnose": diagnose},
    "Plan measurements": {"sensitivity": planning.app},
    "Simulate and build": {"simulate": simulate, "transient": transient, "build": build, "atlas": atlas},
    "Evidence": {"validate": validate, "hide": hide},
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


for _group, _commands in COMMANDS.items():
    for _name, _command in _commands.items():
        if isinstance(_command, typer.Typer):
            app.add_typer(_command, name=_name, rich_help_panel=_group)
        else:
            app.command(_name, rich_help_panel=_group)(_command)


def main() -> None:
    """Run the command line; a user's mistake ends as one line and exit status 2, an interruption as one line too."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed before the start, as by >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    try:
        with interruptible(), warnings.catch_warnings():
            warnings.simplefilter("ignore", append=True)  # of libraries, next to our one line
            _check_arguments(sys.argv[1:])
            status = app(prog_name="capsbayes", standalone_mode=False) or 0
            sys.stdout.flush()
        sys.exit(status)
    except Interrupted as error:
        kept = "; ".join(getattr(error, "__notes__", ["nothing is kept"]))
        command = shlex.join(["capsbayes", *sys.argv[1:]])
        typer.echo(f"capsbayes: interrupted; {kept}; to go on: {command}", err=True)
        sys.exit(error.exit_status)
    except CapsbayesError as error:
        _end("capsbayes", str(error))
    except BrokenPipeError:  # nobody reads on, as behind | head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        _end("capsbayes", f"{error.filename or 'output'}: {error.strerror or error}")
    except MemoryError:
        _end("capsbayes", "not enough memory")
    except UsageError as error:
        command = error.ctx.command_path if error.ctx else "capsbayes"
        if error.format_message():  # not where the help was shown for want of a command
            _end(command, f"{error.format_message()} (see {command} --help)")
        sys.exit(2)
    except typer.Abort:
        typer.echo("capsbayes: interrupted", err=True)
        sys.exit(130)


def _check_arguments(arguments: list[str]) -> None:
    """Refuse an option or argument whose text is empty: an empty path would be the working folder."""
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if not argument.strip() or (argument.startswith("--") and argument.endswith("=")):
            raise InputError(argument.strip("= ") or before or "capsbayes", "", "a value", "an empty text")


def _end(command: str, message: str) -> NoReturn:
    """Print a message as one line without control characters, and exit with status 2."""
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(message.split()))
    typer.echo(f"{command}: {line if len(line) <= _LONGEST else f'{line[:_LONGEST]} ...'}", err=True)
    sys.exit(2)
