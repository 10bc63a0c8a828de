"""The record of the diagnosis that the locked half of the exam is opened with."""

from __future__ import annotations

import hashlib
import json
import os
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import capsbayes
from capsbayes.errors import InputError
from capsbayes.files.output_file import make_folder, write_file

_ROOMS = ("diagnosis", "effects", "infer/outline", "surrogate")
_FILES = ("infer/kernel.py", "least_squares.py", "measured_outline.py", "prediction.py", "profile.py")
_RECORD = "frozen.json"


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Return a hash of the code that decides an answer, its thresholds among it."""
    digest, root = hashlib.sha256(), Path(str(files(capsbayes)))
    of_rooms = (file for room in _ROOMS for file in sorted(root.joinpath(room).rglob("*.py")))
    for file in (*of_rooms, *(root / name for name in _FILES)):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def freeze(out: str | os.PathLike[str]) -> None:
    """Record the code of the diagnosis in the folder of the exam.

    Raises
    ------
    InputError
        If the locked half was opened with other code: what was seen of it cannot be unseen.
    """
    folder = Path(out)
    if frozen(folder) not in (None, code_digest()) and any((folder / "locked").glob("*.jsonl")):
        expected, got = "a locked half that was not opened yet", "answers of another diagnosis"
        raise InputError(str(folder / "locked"), "", expected, got, "draw a new half with other seeds")
    make_folder(folder)
    write_file(folder / _RECORD, json.dumps({"code": code_digest(), "version": capsbayes.__version__}) + "\n")


def frozen(out: str | os.PathLike[str]) -> str | None:
    """Return the hash of the code that was recorded, None if none was."""
    record = Path(out) / _RECORD
    return str(json.loads(record.read_text(encoding="utf-8"))["code"]) if record.exists() else None


def check_frozen(out: str | os.PathLike[str]) -> None:
    """Refuse to open the locked half with a diagnosis that was not frozen, or has changed since.

    Raises
    ------
    InputError
    """
    there = frozen(out)
    if there != code_digest():
        got = "none" if there is None else "that of another diagnosis"
        raise InputError("exam", "--half locked", "the record of this diagnosis", got, "freeze it first with --freeze")
