"""Options that take one of a few names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capsbayes.errors import InputError


def one_of(command: str, option: str, name: str, known: Mapping[str, Any]) -> Any:
    """What `name` stands for among the `known`; otherwise the user is told the names there are."""
    if name not in known:
        raise InputError(command, option, f"one of {', '.join(known)}", repr(name))
    return known[name]
