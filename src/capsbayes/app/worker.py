"""Processes apart, with limits of memory and time: one that computes tasks, and commands of the command line."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from capsbayes.app.stated import page_words
from capsbayes.errors import CapsbayesError
from capsbayes.run import LINES, line_read

MOST_MEMORY = 8 * 2**30
"""Bytes of address space of the process; compiled libraries alone map two of them."""

LONGEST_START = 900.0
"""Seconds until the process is ready: it compiles functions the first time, on slow machines for minutes."""

FAILED = (
    "The file could not be read or computed with: the process that tried was ended. Nothing that was saved is lost."
)

LONGEST_COMMAND = 1800.0
"""Seconds of a command."""

_COMMAND = "from capsbayes.cli import main; main()"
_LIMITED = f"from capsbayes.app.worker import limit_memory; limit_memory(); {_COMMAND}"
_LONGEST_LINE = 2**20  # bytes
Watch = Callable[[float, float | None, str], object]
"""Function of what is done, of how much (None if that is not known), and of what."""


class WorkFailedError(CapsbayesError):
    """A task that was refused, took too long or ended its process; the message is for the page."""


class Worker:
    """One process that computes one task after the other; a new one takes the place of one that was ended.

    Its module has the functions ``TASKS`` by their names, and ``warm``, which is called first.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._lock = asyncio.Lock()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._ready = False

    async def run(self, task: str, /, *, seconds: float = 60.0, **arguments: Any) -> Any:
        """Compute a task of the module by its name."""
        # `WorkFailedError` has the one line of a refusal; it is raised too if the task takes longer than `seconds`,
        # once the process is ready, or ends it.
        async with self._lock:
            answer = await asyncio.to_thread(self._answer, (task, arguments), seconds)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def start(self) -> None:
        """Start the process, which imports what tasks need before the first one comes."""
        if self._process is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")
            self._pipe, other = context.Pipe()
            self._ready = False
            self._process = context.Process(
                target=_serve, args=(other, self._module), daemon=True, name="capsbayes-bench"
            )
            self._process.start()
            other.close()

    def stop(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.join()

    def _answer(self, task: tuple[str, dict[str, Any]], seconds: float) -> Any:
        self.start()
        assert self._pipe is not None
        try:
            if not self._ready:
                self._ready = _received(self._pipe, LONGEST_START)
            self._pipe.send(task)
            good, answer = _received(self._pipe, seconds)
            return answer if good else WorkFailedError(answer)
        except (EOFError, OSError) as error:
            self.stop()
            return WorkFailedError(error if isinstance(error, TimeoutError) else FAILED)


def _received(pipe: Connection, seconds: float) -> Any:
    if not pipe.poll(seconds):
        raise TimeoutError(f"This took longer than {seconds:g} s and was stopped. Nothing that was saved is lost.")
    return pipe.recv()


def _serve(pipe: Connection, module: str) -> None:
    """Say once that the process is ready, and answer tasks until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server answers it, and ends this process
    limit_memory()
    tasks = importlib.import_module(module)
    warnings.simplefilter("ignore")
    tasks.warm()
    pipe.send(True)
    while True:
        try:
            name, arguments = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send((True, tasks.TASKS[name](**arguments)))
        except CapsbayesError as error:
            pipe.send((False, page_words(error)))
        except MemoryError:
            pipe.send((False, "There is not enough memory for this file."))
        except Exception as error:  # the page says it; the process goes on
            pipe.send((False, f"This failed: {type(error).__name__}: {error}"))


def limit_memory() -> None:
    """Limit the memory of this process to `MOST_MEMORY`, where the system does so: on Linux."""
    try:
        import resource
    except ImportError:  # where the system has no such limits
        return
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    limit = MOST_MEMORY if most == resource.RLIM_INFINITY else min(MOST_MEMORY, most)
    with contextlib.suppress(ValueError, OSError):  # macOS knows the limit and refuses to set it
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))


async def printed_by(
    arguments: list[str],
    folder: Path,
    watch: Watch = lambda done, total, what: None,
    *,
    limited: bool = False,
    seconds: float = LONGEST_COMMAND,
) -> tuple[int, str]:
    """Run a command, the words behind ``capsbayes``, in a folder; return its exit status and what it printed.

    Its memory is limited where files of unknown origin are decoded.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", _LIMITED if limited else _COMMAND, *arguments,
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


async def _watched(stream: asyncio.StreamReader, watch: Watch) -> str:
    """Hand on the lines of progress; return the others."""
    others = []
    async for line in stream:
        if (progress := line_read(text := line.decode(errors="replace"))) is None:
            others.append(text)
        else:
            watch(*progress)
    return "".join(others)
