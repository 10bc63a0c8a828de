"""Progress bars on standard error, on a terminal only."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")
_PERIOD = 1.0  # s between two counts


@contextlib.contextmanager
def progress_bar(
    total: float | None, what: str, *, show: bool = True, count: Callable[[], tuple[float, str]] | None = None
) -> Iterator[Callable[..., None]]:
    """Show a progress bar while work goes on.

    Parameters
    ----------
    total : float or None
        How much there is to do, None if that is not known yet.
    what : str
        What is counted, as ``"cases"``.
    show : bool
        False for no bar at all.
    count : callable, optional
        Counts what is done and says what it is, as ``(3, "cases")``; it is called every second and once at the end.

    Yields
    ------
    callable
        ``update(done, what=None, total=None)`` moves the bar.
    """
    if not (show and sys.stderr.isatty()):
        yield lambda done, what=None, total=None: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    layout = (BarColumn(), TextColumn("{task.fields[count]} {task.description}"))
    times = (TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*layout, *times, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total, count="")

        def update(done: float, what: str | None = None, total: float | None = None) -> None:
            bar.update(task, completed=done, description=what, total=total)
            known = bar.tasks[0].total
            bar.update(task, count=f"{done:g}" if known is None else f"{done:g}/{known:g}")

        with _repeated(lambda: update(*count())) if count else contextlib.nullcontext():
            yield update


def tracked(items: Iterable[T], total: float, what: str) -> Iterator[T]:
    """Yield the items one by one, with a progress bar that counts those that are done."""
    with progress_bar(total, what) as update:
        for done, item in enumerate(items, start=1):
            yield item
            update(done)


@contextlib.contextmanager
def _repeated(action: Callable[[], None]) -> Iterator[None]:
    """Do something again and again while other work goes on, and once more at the end."""
    over = threading.Event()

    def repeat() -> None:
        while not over.wait(_PERIOD):
            action()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        action()
