"""TOML files read with every key checked; a mistake is one line with file, key, expected and got."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from capsbayes.errors import CapsbayesError, InputError
from capsbayes.files.output_file import note_input
from capsbayes.quantity import LARGEST, Quantity

Reader = Callable[[Any, str, str], Any]
"""Function of a value, the file and the dotted key; it returns what the value means, or raises InputError."""

PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
VIDEOS = (".avi", ".mp4", ".mov", ".mkv")

Keys = Mapping[str, Reader] | Collection[str]

_SHOWN = 40  # letters of a number that is none, in a message


@dataclass(frozen=True, eq=False)
class InputFile:
    """Content of a TOML file."""

    path: Path  # place of the file
    content: Mapping[str, Any]  # keys and tables
    sha256: str  # fingerprint of its bytes

    @classmethod
    def read(cls, path: str | Path) -> InputFile:
        """Read a file."""
        raw, path = read_bytes(path), Path(path)
        with parsing(str(path), "a TOML file"):  # not TOML, or an integer of thousands of digits
            content = tomllib.loads(text_of(raw, str(path)))
            _check_integers(content)
        return cls(path, content, hashlib.sha256(raw).hexdigest())

    def table(self, name: str = "", **keys: Any) -> dict[str, Any]:
        """Return one table, by default the keys at the top of the file, as `checked_table` does with these keys."""
        return checked_table(self.content.get(name, {}) if name else self.content, str(self.path), name, **keys)


def read_bytes(path: str | Path, noun: str = "file") -> bytes:
    """Return the content of a file of a user."""
    check_file(path, noun)
    with parsing(str(path), f"a readable {noun}"):
        note_input(Path(path))
        return Path(path).read_bytes()


def text_of(raw: bytes, where: str) -> str:
    """Return the text of a file in UTF-8, UTF-16 or Windows-1252, each line ended as in Python."""
    encodings = ["utf-8-sig", "cp1252"]
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    elif b"\0" in raw[:2]:
        encodings = ["utf-16-be" if raw[:1] == b"\0" else "utf-16-le"]
    for encoding in encodings:
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    got = "zero bytes" if b"\0" in raw else "other bytes"
    raise InputError(where, "", "a text in UTF-8, UTF-16 or Windows-1252", got)


def check_file(path: str | Path, noun: str = "file") -> None:
    """Refuse a path that names no file: reading a pipe or a device may never end."""
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(repr(path)[:60], "", f"the path of a {noun}", f"one of the type {type(path).__name__}")
    try:
        mode = os.stat(path).st_mode
        if not stat.S_ISREG(mode):
            got = "a folder" if stat.S_ISDIR(mode) else "a pipe or socket" if not stat.S_ISCHR(mode) else "a device"
            raise InputError(str(path), "", f"a readable {noun}", got)
    except FileNotFoundError:
        raise InputError(str(path), "", f"a {noun}", "nothing there") from None
    except OSError as error:
        raise InputError(str(path), "", f"a readable {noun}", str(error.strerror)) from None
    except ValueError:
        raise InputError(repr(str(path)), "", f"a {noun}", "a name that no file can have") from None


@contextlib.contextmanager
def parsing(where: str, expected: str, advice: str = "") -> Iterator[None]:
    """Refuse in one line what a parser of a user's file cannot read: each library has errors of its own."""
    try:
        yield
    except CapsbayesError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(where, "", expected, f"a file that cannot be read as one ({reason})", advice) from None


def checked_table(
    table: Any,
    where: str,
    name: str,
    *,
    required: Keys = (),
    optional: Keys = (),
    renamed: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return a table after checking its keys and reading its values."""
    if not isinstance(table, Mapping):
        raise InputError(where, name, f"a table [{name}]", repr(table))
    table = {key if renamed.get(key, key) in table else renamed.get(key, key): table[key] for key in table}
    readers = _readers(required) | _readers(optional)
    for key in table:
        if key not in readers:
            raise InputError(where, _dotted(name, key), f"one of {', '.join(readers)}", "an unknown key")
    for key in required:
        if key not in table:
            raise InputError(where, _dotted(name, key), "a value", "nothing", "add the missing key")
    return {key: readers[key](value, where, _dotted(name, key)) for key, value in table.items()}


def _readers(keys: Keys) -> dict[str, Reader]:
    return dict(keys) if isinstance(keys, Mapping) else dict.fromkeys(keys, unread)


def unread(value: Any, where: str, key: str) -> Any:
    """Return a value as it is."""
    return value


def number(least: float = -LARGEST, most: float = LARGEST) -> Reader:
    """Return a reader of a number without a unit, from the least to the most."""

    def read(value: object, where: str, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
            raise InputError(where, key, f"a number from {least:g} to {most:g}", repr(value)[:_SHOWN])
        return float(value)

    return read


def file_name(example: str) -> Reader:
    """Return a reader of the name of a file, relative to the file that states it."""

    def read(value: object, where: str, key: str) -> Path:
        if not isinstance(value, str) or not value.strip() or "\0" in value:
            raise InputError(where, key, f'the name of a file like "{example}"', repr(value))
        return Path(where).parent / value

    return read


def quantity(name: str) -> Reader:
    """Return a reader of the text of a quantity in `capsbayes.parameters`."""
    return lambda value, where, key: Quantity.of_text(value, name, where=where, key=key)


def _check_integers(value: Any) -> None:
    """Refuse integers of more than the 64 bits that TOML has."""
    if isinstance(value, int) and abs(value) >= 2**63:
        raise ValueError("an integer of more than 64 bits")
    for one in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_integers(one)


def _dotted(table: str, key: str) -> str:
    return f"{table}.{key}" if table else key
