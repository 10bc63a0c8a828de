"""Where columns are computed: in this process, in worker processes of this machine, or on a dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from capsbayes.errors import InputError

__all__ = ["computed"]

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

T = TypeVar("T")


def computed(tasks: Sequence[Callable[[], T]], scheduler: str | None, workers: int | None) -> list[T]:
    """Results of independent tasks, in their order.

    Parameters
    ----------
    tasks : sequence of callables
        Without arguments, picklable.
    scheduler : str or None
        Address of a dask cluster, ``"synchronous"`` for this process, or None for worker processes.
    workers : int or None
        Number of worker processes; by default, one for each core.

    Raises
    ------
    InputError
        If no cluster answers.
    """
    if scheduler == "synchronous":
        return [task() for task in tasks]
    if scheduler is not None:
        with _cluster(scheduler) as client:
            return list(client.gather([client.submit(task, pure=False) for task in tasks]))
    import dask

    delayed = [dask.delayed(task, pure=False, traverse=False)() for task in tasks]
    with _one_thread_each():
        return list(
            dask.compute(
                *delayed,
                scheduler="processes",
                num_workers=workers,
                chunksize=1,  # tasks differ much in length, so each worker takes one at a time
                initializer=_end_with_the_build,
            )
        )


def _cluster(address: str) -> Any:
    from distributed import Client

    try:
        # not the process's default: xarray would ask a client that never connected for its locks
        return Client(address, timeout=10.0, set_as_default=False)
    except (OSError, RuntimeError, ValueError) as error:  # no one there, or no address at all
        reason = " ".join(str(error).split())[:120]
        raise InputError("scheduler", "", "address of a running dask scheduler", f"{address!r} ({reason})") from error


def _end_with_the_build() -> None:
    """Let this worker process end when the build is killed; otherwise it waits for work for ever."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Environment of the worker processes while they start: one thread for each."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
