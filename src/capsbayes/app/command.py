"""A command of the command line as a process of its own, whose progress the page shows."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable
from pathlib import Path

from capsbayes.run import LINES, line_read

LONGEST = 1800.0
"""Seconds of a command."""

_STARTED = "from capsbayes.cli import main; main()"
_LIMITED = f"from capsbayes.app.worker import limit_memory; limit_memory(); {_STARTED}"
_LONGEST_LINE = 2**20  # bytes


async def printed_by(
    arguments: list[str],
    folder: Path,
    watch: Callable[[float, float | None, str], object] = lambda done, total, what: None,
    *,
    limited: bool = False,
    seconds: float = LONGEST,
) -> tuple[int, str]:
    """Run a command; return its exit status and what it printed.

    Parameters
    ----------
    arguments : list of str
        Behind the word ``capsbayes``.
    folder : Path
        In which it runs.
    watch : function
        Called with what is done, of how much (None if that is not known), and of what.
    limited : bool
        Whether the memory is limited, as where files of unknown origin are decoded.
    seconds : float
        After which it is stopped.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", _LIMITED if limited else _STARTED, *arguments,
        cwd=folder, env=os.environ | {LINES: "lines"}, limit=_LONGEST_LINE,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        async with asyncio.timeout(seconds):
            printed, complaints = await asyncio.gather(process.stdout.read(), _watched(process.stderr, watch))
            await process.wait()
    except TimeoutError:
        return 2, f"This took longer than {seconds:g} s and was stopped."
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return process.returncode or 0, printed.decode(errors="replace") + complaints


async def _watched(stream: asyncio.StreamReader, watch: Callable[[float, float | None, str], object]) -> str:
    """Hand on the lines of progress; return the others."""
    others = []
    async for line in stream:
        text = line.decode(errors="replace")
        progress = line_read(text)
        if progress is None:
            others.append(text)
        else:
            watch(*progress)
    return "".join(others)
