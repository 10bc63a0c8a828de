"""What values consist of, so that finished work is found again by the content of what it depends on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from capsbayes.quantity import Quantity

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
    if is_dataclass(value):
        names = [item.name for item in fields(value) if item.name not in _PLACES]
        return type(value).__name__, [(name, content_of(getattr(value, name))) for name in names]
    return value
