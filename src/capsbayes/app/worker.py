"""A process apart that decodes uploaded files and computes, with limits of memory and time."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import signal
from multiprocessing.connection import Connection
from typing import Any

from capsbayes.app.stated import said
from capsbayes.errors import CapsbayesError

MOST_MEMORY = 8 * 2**30
"""Bytes of address space of the process; compiled libraries alone map two of them."""

LONGEST_START = 900.0
"""Seconds until the process is ready: it compiles functions the first time, on slow machines for minutes."""

FAILED = (
    "The file could not be read or computed with: the process that tried was ended. Nothing that was saved is lost."
)


class WorkFailedError(CapsbayesError):
    """A task that was refused, took too long or ended its process; the message is for the page."""


class Worker:
    """One process that computes one task after the other; a new one takes the place of one that was ended.

    Parameters
    ----------
    module : str
        Module with the functions ``TASKS`` by their names, and ``warm``, which is called first.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._lock = asyncio.Lock()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._ready = False

    async def run(self, task: str, /, *, seconds: float = 60.0, **arguments: Any) -> Any:
        """Compute a task of the module by its name.

        Raises
        ------
        WorkFailedError
            With the one line of a refusal, or if it takes longer than `seconds`, once the process is ready, or ends it.
        """
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
        except TimeoutError as error:
            reason = str(error)
        except (EOFError, OSError):
            reason = FAILED
        self.stop()
        return WorkFailedError(reason)


def _received(pipe: Connection, seconds: float) -> Any:
    if not pipe.poll(seconds):
        raise TimeoutError(f"This took longer than {seconds:g} s and was stopped. Nothing that was saved is lost.")
    return pipe.recv()


def _serve(pipe: Connection, module: str) -> None:
    """Say once that the process is ready, and answer tasks until the other end is closed."""
    import importlib
    import warnings

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
            pipe.send((False, said(error)))
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
