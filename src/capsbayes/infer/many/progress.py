"""Progress of a run, counted in the files that its workers leave."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from capsbayes.physics.simulation.progress import repeated

__all__ = ["progress_bar"]


@contextlib.contextmanager
def progress_bar(files: Sequence[Path], what: str, *, show: bool) -> Iterator[None]:
    """Bar that counts the files that are there, on a terminal only.

    Parameters
    ----------
    files : sequence of Path
        One for each task.
    what : str
        What is counted.
    show : bool
    """
    if not (show and sys.stderr.isatty()):
        yield
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    layout = (BarColumn(), MofNCompleteColumn(), TextColumn(what), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*layout, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=len(files))
        with repeated(lambda: bar.update(task, completed=sum(file.exists() for file in files))):
            yield
