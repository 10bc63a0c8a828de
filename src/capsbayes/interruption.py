"""Interruptions by SIGINT and SIGTERM, and what they leave behind."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

_PATIENCE = 1.0  # s after which a second signal ends the process at once; `timeout` sends two in a row


class Interrupted(BaseException):
    """The process was asked to end by the signal of a number."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(signal.Signals(number).name)

    @property
    def exit_status(self) -> int:
        """Exit status of a process that a signal ended."""
        return 128 + self.number


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Turn SIGINT and SIGTERM into `Interrupted`, unless the process was started to ignore them (`nohup`)."""
    first: list[float] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if not first:
            first.append(time.monotonic())
            raise Interrupted(number)
        if time.monotonic() - first[0] > _PATIENCE:
            os._exit(128 + number)

    heeded = [number for number in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, stop) for number in heeded}
    try:
        yield
    except Exception as error:
        raise_interruption(error)
        raise
    finally:
        if not first:
            for number, handler in before.items():
                signal.signal(number, handler)


def raise_interruption(error: BaseException) -> None:
    """Raise the interruption that an error hides, if any; whoever catches all errors asks here first."""
    # Compiled code that is interrupted when it returns ends with a SystemError whose cause is the interruption.
    hidden: BaseException | None = error
    while hidden is not None:
        if isinstance(hidden, (Interrupted, KeyboardInterrupt)):
            raise hidden from None
        hidden = hidden.__cause__ or hidden.__context__


@contextlib.contextmanager
def keeping(place: Path, parts: Path | None = None) -> Iterator[None]:
    """Note at an interruption where finished work is kept, if any is: files in `parts`, by default in the place."""
    try:
        try:
            yield
        except Exception as error:
            raise_interruption(error)
            raise
    except (Interrupted, KeyboardInterrupt) as error:
        if _holds_work(parts or place):
            error.add_note(f"finished work is kept in {place}")
        raise


def _holds_work(place: Path) -> bool:
    """Tell whether a file, or a file in a folder, is there that is more than settings and bookkeeping."""
    return any(
        file.is_file() and file.name != "settings.json" and not file.name.startswith(".")
        for file in (place, *place.rglob("*"))
    )
