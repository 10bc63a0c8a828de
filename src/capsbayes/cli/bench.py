"""``capsbayes app``: the bench, a page in a browser from a picture to a report."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from capsbayes.cli.paths import Writes
from capsbayes.errors import InputError


def bench(
    folder: Annotated[
        Path,
        typer.Option(help="Folder in which capsules are kept, one folder each; no other user can enter it."),
        Writes(within=()),
    ] = Path("capsbayes-bench"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on this machine; 0 for any that is free.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser, or print its address only.")
    ] = True,
) -> None:
    """Open the bench in a browser: from a picture to the report, without a line of code.

    The page is served on this machine alone, to the browser that opens the address that is printed; it works once.
    """
    if importlib.util.find_spec("nicegui") is None:
        advice = 'install it with pip install "capsbayes[app]"'
        raise InputError("app", "", "the package that serves the page", "no nicegui", advice)
    import webbrowser

    from capsbayes.app.server import serve

    serve(folder, port, webbrowser.open if browser else None)
