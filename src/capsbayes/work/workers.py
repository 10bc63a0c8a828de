"""Where independent tasks are computed: in this process, in worker processes of this machine, or on a dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

from capsbayes.errors import InputError

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

T = TypeVar("T")


def run_tasks(tasks: Sequence[Callable[..., T]], scheduler: str | None, workers: int | None, *shared: Any) -> list[T]:
    """Compute independent tasks and return their results in the same order.

    Parameters
    ----------
    tasks : sequence of callables
        Picklable; each is called with `shared`.
    scheduler : str or None
        Address of a dask cluster, ``"synchronous"`` for this process, or None for worker processes.
    workers : int or None
        Number of worker processes; by default, one for each core.
    *shared
        What all tasks need, as a model: it is sent to each worker once.

    Raises
    ------
    InputError
        If no cluster answers.
    """
    if scheduler == "synchronous":
        return [task(*shared) for task in tasks]
    if scheduler is not None:
        with _cluster(scheduler) as client:
            sent = client.scatter(list(shared), broadcast=True, hash=False) if shared else []
            return list(client.gather([client.submit(task, *sent, pure=False) for task in tasks]))
    import cloudpickle
    import dask

    delayed = [dask.delayed(partial(_with_shared, task), pure=False, traverse=False)() for task in tasks]
    with _one_thread_each():
        return list(
            dask.compute(
                *delayed,
                scheduler="processes",
                num_workers=workers,
                chunksize=1,  # tasks differ much in length, so each worker takes one at a time
                initializer=partial(_start_worker, cloudpickle.dumps(shared)),
            )
        )


_shared: tuple[Any, ...] = ()


def _with_shared(task: Callable[..., T]) -> T:
    return task(*_shared)


def _start_worker(shared: bytes) -> None:
    """Receive what all tasks share; end the process when its parent ends; otherwise it would wait for ever."""
    import cloudpickle

    global _shared
    _shared = cloudpickle.loads(shared)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _cluster(address: str) -> Any:
    from distributed import Client

    try:
        # not the process's default: xarray would ask a client that never connected for its locks
        return Client(address, timeout=10.0, set_as_default=False)
    except (OSError, RuntimeError, ValueError) as error:  # no scheduler there, or no valid address
        reason = " ".join(str(error).split())[:120]
        raise InputError("scheduler", "", "address of a running dask scheduler", f"{address!r} ({reason})") from error


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let worker processes that start meanwhile use one thread each."""
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
