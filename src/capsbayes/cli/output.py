"""What commands print, and the writers of their files."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import typer

from capsbayes.cli.command import wants_json
from capsbayes.files.output_file import together, write_file
from capsbayes.report.files import Writer

if TYPE_CHECKING:
    import pandas as pd

    from capsbayes.status import Status


def tell(result: Any, *lines: str, good: bool = True) -> None:
    """Print a result as JSON where that is asked for, else lines as they are; end with exit status 1 if not good."""
    for line in [json.dumps(result, indent=2)] if wants_json.get() else lines:
        typer.echo(line)
    if not good:
        raise typer.Exit(1)


def waiting(words: str) -> contextlib.AbstractContextManager[object]:
    """Show what is done, on a terminal, as long as it takes."""
    from rich.console import Console

    return Console(stderr=True).status(words)


def table_file(table: pd.DataFrame, **how: Any) -> Writer:
    """Return a function that writes a table into a CSV file; `how` as of `pandas.DataFrame.to_csv`."""
    from capsbayes.files.csv_file import text_of_table

    return lambda path: write_file(path, text_of_table(table, **how))


def model_words(name: str, sha256: str, seed: int | None = None) -> str:
    """Name the model, the start of the hash of its data, and the seed."""
    return f"Model: {name}, sha256 {sha256[:12]}{'' if seed is None else f'; seed {seed}'}."


def conclude(
    result: Any,
    parts: Iterable[str | pd.DataFrame],
    files: Mapping[str, Writer] = MappingProxyType({}),
    *,
    out: Path | None = None,
    status: Status | None = None,
    status_words: str | None = None,
    lines: Iterable[str] = (),
    good: bool = True,
) -> None:
    """Write the files of a result, all or none, and print it; end with exit status 1 if it or its status is not good.

    With ``--json`` the `result` is printed, without it the `parts`, `status_words` where there is more to say than the
    sentence of the status, and `lines` as they are.
    """
    good = good and (status is None or status.ok)
    if out is not None:
        with together():
            for name, write in files.items():
                write(out / name)
    if not wants_json.get():
        from capsbayes.report.tables import print_parts

        written = "" if out is None else f"Written to {out}: {', '.join(files)}."
        print_parts(*parts, written, status=status_words or status, good=good)
    tell(result, *lines, good=good)
