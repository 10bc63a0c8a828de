"""Arguments of the public functions, compared with their annotations before anything is computed."""

from __future__ import annotations

import functools
import importlib
import inspect
import numbers
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from capsbayes.errors import InputError
from capsbayes.measurement import MID_PLANE
from capsbayes.model import ForwardModel

P = ParamSpec("P")
T = TypeVar("T")

_NUMBERS: dict[Any, Any] = {int: numbers.Integral, float: numbers.Real, bool: (bool, np.bool_)}  # numpy's among them


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Let a function refuse arguments of other types than annotated, and take a model by its name."""
    # What an annotation alone cannot tell, as of arrays, is left to the function.
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> T:
        try:
            bound = signature.bind(*arguments, **options)
        except TypeError as error:
            raise TypeError(f"{function.__name__}: {error}; it takes {', '.join(signature.parameters)}") from None
        models = []
        for key, value in bound.arguments.items():
            kinds = _kinds(function, key)
            if isinstance(value, str) and not value.strip() and "Path" in str(signature.parameters[key].annotation):
                raise InputError(function.__name__, key, "a path", "an empty text, which would be the working folder")
            if isinstance(value, str) and any(issubclass(kind, ForwardModel) for kind in _classes(kinds)):
                models.append(key)
            elif kinds is not None and not any(_is(value, kind) for kind in kinds):
                raise InputError(function.__name__, key, *_words(kinds, value))
        seed = bound.arguments.get("seed", 0)
        if isinstance(seed, numbers.Integral) and int(seed) < 0:
            raise InputError(function.__name__, "seed", "a whole number from 0 on", repr(seed))
        for key in models:
            opened = importlib.import_module("capsbayes.surrogate").model_named  # a floor above this one
            bound.arguments[key] = opened(bound.arguments[key], _view(bound.arguments.values()))
        return function(*bound.args, **bound.kwargs)

    return call


@functools.cache
def _kinds(function: Callable[..., Any], key: str) -> tuple[Any, ...] | None:
    """Return the kinds of values that an argument may be of; None if that cannot be told."""
    inner = inspect.unwrap(function)
    only = types.SimpleNamespace(__annotations__={key: inspect.signature(inner).parameters[key].annotation})
    try:
        told = get_type_hints(only, globalns=inner.__globals__)[key]
    except NameError:  # imported for type checkers alone
        return None
    kinds = get_args(told) if get_origin(told) in (Union, types.UnionType) else (told,)
    return kinds if all(map(_is_plain, kinds)) else None


def _is_plain(kind: Any) -> bool:
    """Tell whether values can be compared with a kind: a class, or a mapping or a sequence of one."""
    if get_origin(kind) is Sequence:
        return isinstance(get_args(kind)[0], type)
    kind = get_origin(kind) or kind
    protocol = getattr(kind, "_is_protocol", False)
    return isinstance(kind, type) and not protocol and kind not in (Any, tuple, list, np.ndarray)


def _is(value: Any, kind: Any) -> bool:
    if get_origin(kind) is Sequence:
        several = isinstance(value, Sequence) and not isinstance(value, str)
        return several and all(_is(one, *get_args(kind)) for one in value)
    plain: Any = get_origin(kind) or kind
    return isinstance(value, _NUMBERS.get(plain, plain))


def _classes(kinds: tuple[Any, ...] | None) -> list[type]:
    return [kind for kind in kinds or () if isinstance(kind, type)]


def _view(arguments: Any) -> str:
    """Return the view of the first outline among the arguments, or among the capsules of one."""
    for value in arguments:
        for measurement in (value, *getattr(value, "measurements", ())):
            outline = getattr(measurement, "outline", None)
            if outline is not None and hasattr(outline, "view"):
                return str(outline.view)
    return MID_PLANE


def _words(kinds: tuple[Any, ...], value: object) -> tuple[str, str, str]:
    """Return what was expected, what was given, and what to do."""
    names = ["None" if kind is types.NoneType else _name(kind) for kind in kinds]
    readable = [kind.__name__ for kind in _classes(kinds) if hasattr(kind, "read")]
    named = bool(readable) and isinstance(value, (str, Path)) and bool(Path(value).suffix)
    advice = f"read the file first: {readable[0]}.read({str(value)!r})" if named else ""
    if isinstance(value, (str, Path, numbers.Number)) or value is None:
        got = repr(value)[:60]
    else:
        got = f"the class {value.__name__}" if isinstance(value, type) else _with_article(type(value))
    return " or ".join(names), got, advice


def _with_article(kind: type) -> str:
    return f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}"


def _name(kind: Any) -> str:
    if kind is int:
        return "a whole number"
    if kind is float:
        return "a number"
    if kind is str:
        return "a text"
    if get_origin(kind) is Sequence:
        return f"a sequence of {get_args(kind)[0].__name__}"
    plain = get_origin(kind) or kind
    name = _with_article(plain)
    return f'{name} or its name, as "square-neo-hookean"' if issubclass(plain, ForwardModel) else name
