"""Steps of a long part, kept until the part is finished, so that an interrupted part goes on where it was."""

from __future__ import annotations

import contextlib
import functools
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from capsbayes import __version__
from capsbayes.errors import InputError, NoRoomError
from capsbayes.files.output_file import make_folder
from capsbayes.interruption import keeping, raise_interruption
from capsbayes.work.digest import digest_of
from capsbayes.work.lock import only_run
from capsbayes.work.store import Store

_SHORT = 0.02  # s of work that are not worth a file

P = ParamSpec("P")
T = TypeVar("T")

_current: ContextVar[Store | None] = ContextVar("_current", default=None)


@contextlib.contextmanager
def steps_kept(store: Store, part: str) -> Iterator[None]:
    """Keep the results of `remembered` functions while a part is computed; remove them once it is finished."""
    folder = store.folder / f"{part}.steps"
    token = _current.set(Store(folder, store.fingerprint))
    finished = False
    try:
        yield
        finished = True
    except Exception as error:
        raise_interruption(error)
        finished = not isinstance(error, NoRoomError)
        raise
    finally:
        _current.reset(token)
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


def step_of(kind: type[T], key: tuple[Any, ...], compute: Callable[[], T]) -> T:
    """Compute a step, or find its result of this type by the content of a key while `steps_kept`."""
    store = _current.get()
    if store is None:
        return compute()
    name = digest_of(key)[:24]
    kept = store.load(name)
    if kept is not None:
        found: T = _built(kind, kept, "result")
        return found
    begin = time.monotonic()
    computed = compute()
    if time.monotonic() - begin > _SHORT:
        with contextlib.suppress(InputError):  # on a full disk the part goes on; its own end is what fails
            store.save(name, dict(_flat(computed, "result")))
    return computed


def step_task(kind: type[T], key: tuple[Any, ...], compute: Callable[..., T]) -> Callable[..., T]:
    """Return `step_of` as a task for `run_tasks`: wherever it runs, it keeps its result where this process would."""
    return keeping_steps(functools.partial(_step, kind, key, compute))


def keeping_steps(task: Callable[..., T]) -> Callable[..., T]:
    """Return a task for `run_tasks` that keeps the results of its own steps where this process would."""
    return functools.partial(_with_store, _current.get(), task)


def _step(kind: type[T], key: tuple[Any, ...], compute: Callable[..., T], *shared: Any) -> T:
    return step_of(kind, key, functools.partial(compute, *shared))


def _with_store(store: Store | None, task: Callable[..., T], *shared: Any) -> T:
    token = _current.set(store)
    try:
        return task(*shared)
    finally:
        _current.reset(token)


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
