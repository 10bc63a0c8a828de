"""Long work: finished parts on disk, a lock on the output, tasks in processes or on a cluster, and a progress bar."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import functools
import hashlib
import io
import json
import logging
import math
import multiprocessing
import os
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from types import ModuleType, NoneType, UnionType
from typing import Any, ParamSpec, Protocol, TypeVar, get_args, get_origin, get_type_hints, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np

from capsbayes import __version__
from capsbayes.errors import DatabaseError, InputError, NoRoomError
from capsbayes.files.output_file import make_folder, refusing, set_within, unguarded, write_file
from capsbayes.interruption import keeping, raise_interruption
from capsbayes.quantity import Quantity

# What values consist of, so that finished work is found again by the content of what it depends on

_PLACES = ("source", "sha256", "experiment_file")  # of what was read: the content itself counts


@runtime_checkable
class _Model(Protocol):
    """A forward model, whose data and effects its sha256 identifies."""

    name: str
    sha256: str
    view: str


def digest_of(*values: Any) -> str:
    """Return a hash of the content of values."""
    return hashlib.sha256(repr([content_of(value) for value in values]).encode()).hexdigest()


def content_of(value: Any) -> Any:
    """Return what a value consists of, in types whose text shows every digit; the place of a file does not count."""
    if isinstance(value, str):  # most values, by far, are names of capsules
        return value
    if isinstance(value, Quantity):
        return value.as_record(), value.unit
    if isinstance(value, _Model):
        return value.name, value.sha256, value.view
    if isinstance(value, bytes):
        return hashlib.sha256(value).hexdigest()
    if isinstance(value, np.ndarray) and value.dtype.kind in "OU":  # the bytes of texts depend on the longest one
        return content_of(value.tolist())
    if isinstance(value, np.ndarray):
        return value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    if isinstance(value, Mapping):
        return sorted((key, content_of(item)) for key, item in value.items())
    if isinstance(value, (tuple, list)):
        return [content_of(item) for item in value]
    if not is_dataclass(value):
        return value
    kind: Any = type(value)
    if kind.__hash__ is not object.__hash__ or not kind.__dataclass_params__.frozen:
        return _content_of_fields(value)
    if value not in _digests:  # the same object has the same content, and is asked for again and again
        _digests[value] = hashlib.sha256(repr(_content_of_fields(value)).encode()).hexdigest()
    return _digests[value]


_digests: WeakKeyDictionary[Any, str] = WeakKeyDictionary()


def _content_of_fields(value: Any) -> Any:
    names = [item.name for item in fields(value) if item.name not in _PLACES]
    return type(value).__name__, [(name, content_of(getattr(value, name))) for name in names]


# A lock on what a run writes, so that no second run writes it at the same time; it dies with its owner

_logger = logging.getLogger(__name__)

_WAIT = 0.2  # s for a lock that its owner is giving up
_WITHOUT_LOCKS = errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP  # as of NFS without its lock service


@contextlib.contextmanager
def only_run(out: Path) -> Iterator[None]:
    """Refuse to write `out` while another run does; make the folder of `out` if it does not exist."""
    # The operating system holds the lock as long as the process lives, on the file ``.NAME.lock`` next to a file, or
    # ``.lock`` in a folder. Without locks there, a warning is logged: results are whole even so, but work may be done
    # twice.
    from filelock import FileLock, Timeout

    with refusing(out, "a place where files can be written"):
        real = out.resolve()
        path = real / ".lock" if real.is_dir() else real.with_name(f".{real.name}.lock")
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, timeout=_WAIT, fallback_to_soft=False)
        try:
            lock.acquire()
        except Timeout:
            owner = path.read_text(encoding="utf-8", errors="replace").strip() or "another process"
            advice = "let it end, or choose another output"
            raise InputError(str(out), "", "no other run that writes it", owner, advice) from None
        except OSError as error:
            if error.errno not in _WITHOUT_LOCKS:
                raise
            _logger.warning("%s cannot be locked (%s): see that no other run writes there.", path, error.strerror)
    try:
        with contextlib.suppress(OSError):  # as on a full disk: the lock counts, not the name
            path.write_text(f"process {os.getpid()} on {socket.gethostname()}\n", encoding="utf-8")
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        lock.release()


# Progress on standard error: bars on a terminal, lines for a program that asked for them

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
    terminal = sys.stderr.isatty()
    if not show or not (terminal or os.environ.get(LINES) == "lines"):
        yield lambda done, what=None, total=None: None
        return
    shown = _bar(total, what) if terminal else contextlib.nullcontext(_Line(total, what))
    with shown as update, _repeated(lambda: update(*count())) if count else contextlib.nullcontext():
        yield update


@contextlib.contextmanager
def _bar(total: float | None, what: str) -> Iterator[Callable[..., None]]:
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


# A folder of finished parts of a long computation, so that an interrupted one resumes.
#
# Each part is one file: a line with the fingerprint of the settings and a hash of the content, then arrays and JSON in
# numpy's npz format, without objects. A file is written under another name and then renamed, so it is whole or absent;
# a damaged one counts as absent. Reading a part never runs code from it

_MAGIC, _PICKLED = b"capsbayes part 2", b"capsbayes part 1"
_SUFFIX = ".part"
_JSON = "json"
_SETTINGS = "settings.json"


@dataclass(frozen=True)
class Store:
    """Folder of finished parts; safe to use from many processes at once."""

    folder: Path
    fingerprint: str  # hash of the settings that decide the parts

    @classmethod
    def open(cls, folder: str | os.PathLike[str], settings: Mapping[str, Any]) -> Store:
        """Open a folder whose parts all have the same settings, in types that JSON has; make it if it is missing."""
        path = Path(folder)
        check_parts(path)
        text = json.dumps(dict(settings), sort_keys=True, indent=1)
        file = path / _SETTINGS
        if file.exists():
            _check_settings(file, text)
        else:
            with unguarded():
                write_file(file, text)
        return cls(path, hashlib.sha256(text.encode()).hexdigest())

    def path(self, name: str) -> Path:
        """Return the file of a part."""
        return self.folder / f"{name}{_SUFFIX}"

    def names(self, pattern: str = "*") -> Iterator[str]:
        """Return the names of the parts that match a glob pattern, damaged ones included."""
        return (path.name.removesuffix(_SUFFIX) for path in self.folder.glob(f"{pattern}{_SUFFIX}"))

    def save(self, name: str, values: Mapping[str, Any]) -> None:
        """Write a part: arrays of numbers or text, and values in types that JSON has."""
        arrays = {key: value for key, value in values.items() if isinstance(value, np.ndarray)}
        text = json.dumps({key: value for key, value in values.items() if key not in arrays})
        if any(array.dtype.hasobject for array in arrays.values()):
            raise TypeError(f"{name}: arrays of objects would be pickled")
        content = io.BytesIO()
        everything: dict[str, Any] = arrays | {_JSON: np.frombuffer(text.encode(), np.uint8)}
        np.savez(content, **everything)
        payload = content.getvalue()
        digest = hashlib.sha256(payload).hexdigest()
        with unguarded():
            write_file(self.path(name), _MAGIC + f" {self.fingerprint} {digest}\n".encode() + payload)

    def remove(self, name: str) -> None:
        """Remove a part, if it is there."""
        self.path(name).unlink(missing_ok=True)

    def holds(self, name: str) -> bool:
        """Return True if a part is there and whole."""
        return self._payload(name) is not None

    def load(self, name: str) -> dict[str, Any] | None:
        """Read a part; None if it is missing or damaged. Refuse other settings and another version's format."""
        payload = self._payload(name)
        if payload is None:
            return None
        with np.load(io.BytesIO(payload), allow_pickle=False) as arrays:
            values = dict(arrays)
        text: dict[str, Any] = json.loads(values.pop(_JSON).tobytes())
        return values | text

    def _payload(self, name: str) -> bytes | None:
        """Return the content of a part, None if it is missing or damaged."""
        path = self.path(name)
        try:
            header, _, payload = path.read_bytes().partition(b"\n")
        except FileNotFoundError:
            return None
        if header.startswith(_PICKLED):
            advice = f"remove {self.folder} to start anew"
            raise DatabaseError(f"{path} was written by an earlier version, whose parts are not read; {advice}")
        fingerprint, _, digest = header.removeprefix(_MAGIC).decode(errors="replace").strip().partition(" ")
        if not header.startswith(_MAGIC) or digest != hashlib.sha256(payload).hexdigest():
            return None
        if fingerprint != self.fingerprint:
            raise DatabaseError(f"{path} was made with other settings; remove it, or build under another name")
        return payload


def check_parts(folder: Path) -> None:
    """Refuse a folder that holds something else than finished parts."""
    expected = "a folder of finished parts, or none"
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "", expected, "a file", "choose another output")
    for path in folder.rglob("*"):
        if not (path.is_dir() or path.suffix == _SUFFIX or path.name == _SETTINGS or path.name.startswith(".")):
            raise InputError(str(folder), "", expected, f"one that holds {path.name}", "choose another output")


def _check_settings(file: Path, asked: str) -> None:
    try:
        there, here = json.loads(file.read_text(encoding="utf-8")), json.loads(asked)
        if not isinstance(there, dict):
            raise ValueError("no object")
    except (ValueError, RecursionError) as error:
        raise DatabaseError(f"{file} is damaged; remove {file.parent} to start anew") from error
    different = ", ".join(
        f"{key} {there.get(key)!r} there and {here.get(key)!r} asked"
        for key in sorted({*there, *here})
        if there.get(key) != here.get(key)
    )
    if different:
        advice = "remove it, or choose another out"
        raise DatabaseError(f"{file.parent} holds parts made with other settings: {different}; {advice}")


# Where independent tasks are computed: in this process, in worker processes of this machine, or on a dask cluster

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_INTERRUPTIONS = (signal.SIGINT, signal.SIGTERM)
_PR_SET_PDEATHSIG = 1  # prctl(2)
_SHARE_OF_TIME = Path("/sys/fs/cgroup/cpu.max")  # of a container on Linux: microseconds in each period, or max
_WAITING = 8  # tasks for each worker that are sent ahead: all of them would be in memory twice


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
            del os.environ[name]
            if value is not None:
                os.environ[name] = value


# Steps of a long part, kept until the part is finished, so that an interrupted part goes on where it was

_SHORT = 0.02  # s of work that are not worth a file

P = ParamSpec("P")

_current: ContextVar[Store | None] = ContextVar("_current", default=None)


@contextlib.contextmanager
def steps_kept(store: Store, part: str) -> Iterator[None]:
    """Keep the results of `remembered` functions while a part is computed; remove them once it is finished."""
    folder = store.folder / f"{part}.steps"
    finished = False
    try:
        with set_within(_current, Store(folder, store.fingerprint)):
            yield
        finished = True
    except Exception as error:
        raise_interruption(error)
        finished = not isinstance(error, NoRoomError)
        raise
    finally:
        if finished:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def resumable(out: Path | None, of: str = "") -> Iterator[None]:
    """Keep the steps of a computation in the folder of its results, so that it goes on when it is started again."""
    # `of` is the fingerprint of what the steps depend on besides their arguments, as a file of effects.
    if out is None:
        yield
        return
    missing = not out.exists()
    make_folder(out)
    try:
        store = Store(out, digest_of(__version__, of))
        with only_run(out), keeping(out, out / "unfinished.steps"), steps_kept(store, "unfinished"):
            yield
    except Exception:
        if missing:
            with contextlib.suppress(OSError):
                out.rmdir()
        raise


def remembered(function: Callable[P, T]) -> Callable[P, T]:
    """Let a slow function find its result again while `steps_kept`; elsewhere it is called as it is."""
    # The result is found by the content of the arguments. It must be None, or a named tuple or a dataclass of arrays,
    # numbers and such; its type is that of the annotation.

    @functools.wraps(function)
    def find(*arguments: P.args, **options: P.kwargs) -> T:
        if _current.get() is None:
            return function(*arguments, **options)
        kind = get_type_hints(function)["return"]
        return step_of(kind, (function.__qualname__, arguments, options), lambda: function(*arguments, **options))

    return find


def step_of(kind: type[T], key: tuple[Any, ...], compute: Callable[..., T], *shared: Any) -> T:
    """Compute a step from what it shares, or find it by a key, whose content decides it, while `steps_kept`."""
    store = _current.get()
    if store is None:
        return compute(*shared)
    name = digest_of(key)[:24]
    kept = store.load(name)
    if kept is not None:
        found: T = _built(kind, kept, "result")
        return found
    begin = time.monotonic()
    computed = compute(*shared)
    if time.monotonic() - begin > _SHORT:
        with contextlib.suppress(InputError):  # on a full disk the part goes on; its own end is what fails
            store.save(name, dict(_flat(computed, "result")))
    return computed


def step_task(kind: type[T], key: tuple[Any, ...], compute: Callable[..., T]) -> Callable[..., T]:
    """Return `step_of` as a task for `run_tasks`: wherever it runs, it keeps its result where this process would."""
    return keeping_steps(functools.partial(step_of, kind, key, compute))


def keeping_steps(task: Callable[..., T]) -> Callable[..., T]:
    """Return a task for `run_tasks` that keeps the results of its own steps where this process would."""
    return functools.partial(_with_store, _current.get(), task)


def _with_store(store: Store | None, task: Callable[..., T], *shared: Any) -> T:
    with set_within(_current, store):
        return task(*shared)


def _flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the arrays and numbers of which a value consists, by the path to each."""
    if is_dataclass(value):
        for item in fields(value):
            yield from _flat(getattr(value, item.name), f"{name}.{item.name}")
    elif isinstance(value, tuple):
        for key, item in value._asdict().items() if hasattr(value, "_asdict") else enumerate(value):
            yield from _flat(item, f"{name}.{key}")
        yield f"{name}.length", len(value)
    else:
        yield name, value.item() if isinstance(value, np.generic) else value


def _built(kind: Any, values: Mapping[str, Any], name: str) -> Any:
    """Return the value of a type that `_flat` took apart."""
    if get_origin(kind) is UnionType:
        if name in values:
            return values[name]
        kind = next(other for other in get_args(kind) if other is not NoneType)
    if get_origin(kind) is tuple:
        return tuple(_built(get_args(kind)[0], values, f"{name}.{key}") for key in range(values[f"{name}.length"]))
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        hints = get_type_hints(kind)
        names = kind._fields if hasattr(kind, "_fields") else [item.name for item in fields(kind)]
        return kind(**{key: _built(hints[key], values, f"{name}.{key}") for key in names})
    return values[name]
