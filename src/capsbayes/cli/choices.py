"""Checks of options that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capsbayes.errors import InputError


def one_of(command: str, option: str, name: str, known: Mapping[str, Any]) -> Any:
    """What `name` stands for among the `known`; otherwise the user is told the names there are."""
    if name not in known:
        raise InputError(command, option, f"one of {', '.join(known)}", repr(name))
    return known[name]


def check_suffix(command: str, option: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuse a file to write, if one is named, with another ending or in a folder that is not there."""
    if path is None:
        return
    if path.suffix not in suffixes:
        raise InputError(command, option, f"a file name that ends in {' or '.join(suffixes)}", repr(str(path)))
    if not path.parent.is_dir():
        raise InputError(command, option, "a folder that exists", repr(str(path.parent)))
