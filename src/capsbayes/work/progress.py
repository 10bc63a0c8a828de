"""Progress on standard error: bars on a terminal, lines for a program that asked for them."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")
_PERIOD = 1.0  # s between two counts

LINES = "CAPSBAYES_PROGRESS"
"""Variable of the environment by which a program asks for lines as ``progress 3 40 capsules``, by its value "lines"."""

_LINE = "progress"
_RAREST = 0.2  # s between two lines


@contextlib.contextmanager
def progress_bar(
    total: float | None, what: str, *, show: bool = True, count: Callable[[], tuple[float, str]] | None = None
) -> Iterator[Callable[..., None]]:
    """Show a progress bar while work goes on; yield ``update(done, what=None, total=None)``, which moves it."""
    # `count` tells what is done and what it is, as ``(3, "cases")``; it is called every second and once at the end.
    if not show or not (sys.stderr.isatty() or os.environ.get(LINES) == "lines"):
        yield lambda done, what=None, total=None: None
        return
    if not sys.stderr.isatty():
        line = _Line(total, what)
        with _repeated(lambda: line(*count())) if count else contextlib.nullcontext():
            yield line
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


def line_read(text: str) -> tuple[float, float | None, str] | None:
    """Return what a line of progress says: what is done, of how much if that is known, and of what; None for others.

    >>> line_read("progress 3 40 capsules"), line_read("progress 3 ? rows"), line_read("Status: Done.")
    ((3.0, 40.0, 'capsules'), (3.0, None, 'rows'), None)
    """
    words = text.split(maxsplit=3)
    if len(words) < 4 or words[0] != _LINE:
        return None
    return float(words[1]), None if words[2] == "?" else float(words[2]), words[3].strip()


class _Line:
    """Writes a line at each update, unless the last one is hardly older."""

    def __init__(self, total: float | None, what: str) -> None:
        self._total, self._what, self._last = total, what, -_RAREST

    def __call__(self, done: float, what: str | None = None, total: float | None = None) -> None:
        self._total, self._what = self._total if total is None else total, what or self._what
        now = time.monotonic()
        if now - self._last > _RAREST or done == self._total:
            self._last = now
            whole = "?" if self._total is None else f"{self._total:g}"
            print(f"{_LINE} {done:g} {whole} {self._what}", file=sys.stderr, flush=True)


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
