"""Progress of a build, counted in its work folders, so that it sees every worker's cases."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator, Sequence

from capsbayes.physics.simulation.parts import Parts

__all__ = ["progress_bar", "repeated"]

Case = tuple[float, float]


@contextlib.contextmanager
def progress_bar(folders: Sequence[Parts], cases: list[Case], *, show: bool) -> Iterator[None]:
    """Bar that counts the cases that have ended in each folder, on a terminal only.

    Parameters
    ----------
    folders : sequence of Parts
    cases : list of (capillary_number, size_ratio)
        Those of each folder.
    show : bool
    """
    if not (show and sys.stderr.isatty()):
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    layout = (BarColumn(), MofNCompleteColumn(), TextColumn("cases, {task.fields[failed]} without a steady state"))
    with Progress(*layout, TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("cases", total=len(folders) * len(cases), failed=0)

        def count() -> None:
            ended, failed = (sum(counts) for counts in zip(*(parts.tally(cases) for parts in folders), strict=True))
            bar.update(task, completed=ended, failed=failed)

        with repeated(count):
            yield


@contextlib.contextmanager
def repeated(count: Callable[[], None], *, every: float = 1.0) -> Iterator[None]:
    """Call a function again and again while something else goes on, and once more in the end.

    Parameters
    ----------
    count : callable
    every : float
        Seconds.
    """
    over = threading.Event()

    def keep_counting() -> None:
        while not over.wait(every):
            count()

    counter = threading.Thread(target=keep_counting, daemon=True)
    counter.start()
    try:
        yield
    finally:
        over.set()
        counter.join()
        count()
