"""The numbers that a simulator or a problem has as parameters: its own and those of its membrane law."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

Owner = TypeVar("Owner")


def parameters_of(owner: Any) -> dict[str, float]:
    """Return the fields of a dataclass and of its `law` that are numbers, but not whole ones."""
    return _numbers(owner) | _numbers(getattr(owner, "law", None))


def changed(owner: Owner, name: str, value: float) -> Owner:
    """Return a dataclass with another value of one of its parameters or of those of its law."""
    if name in _numbers(owner):
        return replace(owner, **{name: value})  # type: ignore[type-var]
    law = owner.law  # type: ignore[attr-defined]
    return replace(owner, law=replace(law, **{name: value}))  # type: ignore[type-var]


def _numbers(owner: Any) -> dict[str, float]:
    values = {field.name: getattr(owner, field.name) for field in fields(owner)} if is_dataclass(owner) else {}
    return {name: value for name, value in values.items() if isinstance(value, float)}
