"""Where independent tasks are computed: in this process, in worker processes of this machine, or on a dask cluster."""

from __future__ import annotations

import contextlib
import ctypes
import math
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from capsbayes.errors import InputError

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_INTERRUPTIONS = (signal.SIGINT, signal.SIGTERM)
_PR_SET_PDEATHSIG = 1  # prctl(2)
_SHARE_OF_TIME = Path("/sys/fs/cgroup/cpu.max")  # of a container on Linux: microseconds in each period, or max
_WAITING = 8  # tasks for each worker that are sent ahead: all of them would be in memory twice

T = TypeVar("T")


def run_tasks(
    tasks: Sequence[Callable[..., T]],
    scheduler: str | None,
    workers: int | None,
    *shared: Any,
    finished: Callable[[int], None] = lambda count: None,
) -> list[T]:
    """Compute independent, picklable tasks, each called with `shared`, and return their results in the same order."""
    # Worker processes end with this process, however it ends; an exception, as `KeyboardInterrupt`, ends them too. They
    # ignore SIGINT and SIGTERM, which this process answers. `scheduler` is the address of a dask cluster, "synchronous"
    # for this process, or None for worker processes, by default one for each core; `shared` is sent to each once.
    if scheduler == "synchronous":
        results = []
        for task in tasks:
            results.append(task(*shared))
            finished(len(results))
        return results
    if scheduler is not None:
        with _cluster(scheduler) as client:
            sent = client.scatter(list(shared), broadcast=True, hash=False) if shared else []
            results = list(client.gather([client.submit(task, *sent, pure=False) for task in tasks]))
        finished(len(results))
        return results
    return _in_processes(tasks, workers, shared, finished) if tasks else []


def usable_cores() -> int:
    """Return how many cores this process may use, a container's share of time counted as cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        allowed, period = _SHARE_OF_TIME.read_text().split()
        return max(1, min(cores, math.ceil(int(allowed) / int(period))))
    except (OSError, ValueError):  # no such file, or no limit
        return cores


def _in_processes(
    tasks: Sequence[Callable[..., T]], workers: int | None, shared: tuple[Any, ...], finished: Callable[[int], None]
) -> list[T]:
    import cloudpickle

    others = set(multiprocessing.active_children())
    start = (_start_worker, (os.getpid(), cloudpickle.dumps(shared)))
    spawn = multiprocessing.get_context("spawn")
    number = min(workers or usable_cores(), len(tasks))
    waiting = _WAITING * number
    with ProcessPoolExecutor(number, spawn, *start) as pool:
        try:
            futures: list[Future[bytes]] = []
            unfinished: set[Future[bytes]] = set()
            for sent in map(cloudpickle.dumps, tasks):
                if len(unfinished) >= waiting:
                    unfinished = _after_the_next(unfinished, len(futures), finished)
                with _settings_of_workers():  # a worker may be started by each submission
                    futures.append(pool.submit(_run, sent))
                unfinished.add(futures[-1])
            while unfinished:
                unfinished = _after_the_next(unfinished, len(futures), finished)
            return [cloudpickle.loads(future.result()) for future in futures]
        except BaseException:
            for worker in set(multiprocessing.active_children()) - others:
                worker.kill()  # one in compiled code would not listen
            # waited for: Python's exit would wake the pool's thread, and print an error if that thread is just ending
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _after_the_next(unfinished: set[Future[bytes]], sent: int, finished: Callable[[int], None]) -> set[Future[bytes]]:
    """Wait for the next result, and return the tasks that are still unfinished; the first error ends the work."""
    done, left = wait(unfinished, return_when=FIRST_COMPLETED)
    for count, future in enumerate(done, start=sent - len(unfinished) + 1):
        future.result()
        finished(count)
    return left


_shared: tuple[Any, ...] = ()


def _run(task: bytes) -> bytes:
    import cloudpickle

    return bytes(cloudpickle.dumps(cloudpickle.loads(task)(*_shared)))


def _start_worker(parent: int, shared: bytes) -> None:
    """Receive what all tasks share; end this process when its parent ends; leave interruptions to the parent."""
    import cloudpickle

    global _shared
    for number in _INTERRUPTIONS:
        signal.signal(number, signal.SIG_IGN)
    _end_with(parent)
    _shared = cloudpickle.loads(shared)


def _end_with(parent: int) -> None:
    """End this process when its parent ends: on Linux at once, elsewhere when compiled code has returned."""
    watched = multiprocessing.parent_process()

    def watch() -> None:
        if watched is not None:
            watched.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before
            os._exit(1)


def _cluster(address: str) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        advice = 'install it with pip install "capsbayes[cluster]"'
        raise InputError("scheduler", "", "the package distributed, of dask", "none installed", advice) from None
    try:
        # not the process's default: xarray would ask a client that never connected for its locks
        return Client(address, timeout=10.0, set_as_default=False)
    except (OSError, RuntimeError, ValueError) as error:  # no scheduler there, or no valid address
        reason = " ".join(str(error).split())[:120]
        raise InputError("scheduler", "", "address of a running dask scheduler", f"{address!r} ({reason})") from error


@contextlib.contextmanager
def _settings_of_workers() -> Iterator[None]:
    """Let worker processes that start meanwhile use one thread each, and defer interruptions until they are ready."""
    # They do not import the script that starts them, which would run it again; what they need of it is sent by value.
    script, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    masked = hasattr(signal, "pthread_sigmask")  # not on Windows
    if masked:
        resource_tracker.ensure_running()  # it would unblock the signals when it starts
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTIONS)
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        if masked:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
