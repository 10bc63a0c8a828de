"""What commands print, and the writers of their files."""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.files.output_file import together, write_file
from capsbayes.report.files import Writer

if TYPE_CHECKING:
    import pandas as pd

    from capsbayes.status import Status


Quiet = Annotated[
    bool, typer.Option("--quiet", help="Print nothing but what went wrong; with --json, nothing but the JSON.")
]


class _NoTerminal(io.TextIOBase):
    """A stream without progress bars, which are drawn on terminals alone."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text as it is."""
        return int(self._stream.write(text))


def quietable(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the option ``--quiet``, with which files and exit status are all that it leaves."""
    signature = inspect.signature(command, eval_str=True)

    @functools.wraps(command)
    def run(**given: Any) -> None:
        if not given.pop("quiet"):
            command(**given)
            return
        with contextlib.ExitStack() as stack:
            stack.enter_context(contextlib.redirect_stderr(_NoTerminal(sys.stderr)))
            if not given.get("as_json"):
                stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
            command(**given)

    own = inspect.Parameter("quiet", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Quiet)
    run.__signature__ = signature.replace(parameters=[*signature.parameters.values(), own])  # type: ignore[attr-defined]
    return run


def print_json(result: Any) -> None:
    """Print a result as JSON."""
    typer.echo(json.dumps(result, indent=2))


def table_file(table: pd.DataFrame, **how: Any) -> Writer:
    """Return a function that writes a table into a CSV file; `how` as of `pandas.DataFrame.to_csv`."""
    from capsbayes.files.csv_file import text_of_table

    return lambda path: write_file(path, text_of_table(table, **how))


def model_words(name: str, sha256: str, seed: int | None = None) -> str:
    """Name the model, the start of the hash of its data, and the seed."""
    return f"Model: {name}, sha256 {sha256[:12]}{'' if seed is None else f'; seed {seed}'}."


def conclude(
    result: Any,
    parts: Callable[[], Sequence[str | pd.DataFrame]],
    files: Mapping[str, Writer],
    *,
    out: Path | None,
    as_json: bool,
    status: Status | None = None,
    status_words: str | None = None,
) -> None:
    """Write the files of a result and print it; end the command with exit status 1 if its status is not good.

    Parameters
    ----------
    result : JSON value
        Printed with ``--json``.
    parts : function that returns a sequence of str and DataFrame
        Sentences and tables, printed without it.
    files : mapping of str to function of a path
        Writer of each file by its name; all files are written, or none.
    out : Path, optional
        Folder of the files.
    as_json : bool
    status : Status, optional
    status_words : str, optional
        Sentence of the status, where there is more to say than its own.
    """
    if out is not None:
        with together():
            for name, write in files.items():
                write(out / name)
    if as_json:
        print_json(result)
    else:
        from capsbayes.report.tables import print_parts

        written = "" if out is None else f"Written to {out}: {', '.join(files)}."
        print_parts(*parts(), written, status=status_words or status, good=status is None or status.ok)
    if status is not None and not status.ok:
        raise typer.Exit(1)
