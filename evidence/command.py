"""What the commands of the evidence share: their arguments, and how they end."""

from __future__ import annotations

import argparse
import shlex
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from capsbayes.errors import CapsbayesError
from capsbayes.files.output_file import guarded
from capsbayes.interruption import Interrupted, interruptible


class Arguments(argparse.ArgumentParser):
    """Arguments of ``python -m evidence.NAME``; a mistake in them is one line."""

    def __init__(self, name: str, description: str) -> None:
        super().__init__(f"python -m evidence.{name}", description=description, allow_abbrev=False)
        self.add_argument(
            "--overwrite",
            action="store_true",
            help="replace files that were not written here, or that were changed since",
        )

    def error(self, message: str) -> NoReturn:
        """End with one line and exit status 2."""
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


def path(text: str) -> Path:
    """Read an argument that names a file or folder; an empty text would be the working folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError("expected a path, got an empty text")
    return Path(text)


def count(text: str) -> int:
    """Read an argument that is a number of something, 1 or more."""
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) > 0):
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text[:40]!r}")
    return int(text)


def tell(line: str) -> None:
    """Print a line of progress, on a terminal alone."""
    if sys.stderr.isatty():
        print(line, file=sys.stderr)


def run(arguments: Arguments, command: Callable[[argparse.Namespace], int]) -> NoReturn:
    """Run a command and exit with its status; a mistake ends as one line and status 2, an interruption as one line."""
    given = arguments.parse_args()
    try:
        with interruptible(), warnings.catch_warnings(), guarded(overwrite=given.overwrite):
            warnings.simplefilter("ignore", append=True)  # of libraries, next to our one line
            status = command(given)
        sys.exit(status)
    except Interrupted as error:
        kept = "; ".join(getattr(error, "__notes__", ["nothing is kept"]))
        again = f"{arguments.prog} {shlex.join(sys.argv[1:])}"
        arguments.exit(error.exit_status, f"{arguments.prog}: interrupted; {kept}; to go on: {again}\n")
    except CapsbayesError as error:
        arguments.exit(2, f"{arguments.prog}: {' '.join(str(error).split())}\n")
    except OSError as error:
        reason = f"{error.filename or 'output'}: {error.strerror or error}"
        arguments.exit(2, f"{arguments.prog}: {reason}\n")
