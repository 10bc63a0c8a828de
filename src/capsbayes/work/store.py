"""A folder of finished parts of a long computation, so that an interrupted one resumes.

Each part is one file: a line with the fingerprint of the settings and a hash of the content, then arrays and JSON in
numpy's npz format, without objects. A file is written under another name and then renamed, so it is whole or absent; a
damaged one counts as absent. Reading a part never runs code from it.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes.errors import DatabaseError, InputError
from capsbayes.files.output_file import unguarded, write_file

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
