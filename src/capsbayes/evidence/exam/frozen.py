"""The record of the diagnosis that the locked half of the exam is opened with."""

from __future__ import annotations

import hashlib
import json
import os
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import capsbayes
from capsbayes.database import shipped_folders
from capsbayes.errors import InputError
from capsbayes.files.output_file import make_folder, write_file

_OTHER = ("app", "cli", "image", "show")  # folders of code that decides no answer
_RECORD = "frozen.json"


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Return a hash of the code that decides an answer, its thresholds among it, and of the databases shipped."""
    digest, root = hashlib.sha256(), Path(str(files(capsbayes)))
    for file in sorted(root.rglob("*.py")):
        name = file.relative_to(root)
        if name.parts[0] not in _OTHER:
            digest.update(name.as_posix().encode() + b"\0" + file.read_bytes())
    for folder in (*shipped_folders(), *shipped_folders("membranes")):
        for file in sorted(folder.glob("*.nc")):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def freeze(out: str | os.PathLike[str]) -> None:
    """Record the code of the diagnosis in the folder of the exam, unless the locked half was opened with other code."""
    # What was seen of the locked half cannot be unseen.
    folder = Path(out)
    if frozen(folder) != code_digest() and any((folder / "locked").glob("*.jsonl")):
        expected, got = "a locked half that was not opened yet", "answers of another diagnosis"
        raise InputError(str(folder / "locked"), "", expected, got, "draw a new half with other seeds")
    make_folder(folder)
    write_file(folder / _RECORD, json.dumps({"code": code_digest(), "version": capsbayes.__version__}) + "\n")


def frozen(out: str | os.PathLike[str]) -> str | None:
    """Return the hash of the code that was recorded, None if none was."""
    record = Path(out) / _RECORD
    return str(json.loads(record.read_text(encoding="utf-8"))["code"]) if record.exists() else None


def check_frozen(out: str | os.PathLike[str]) -> None:
    """Refuse to open the locked half with a diagnosis that was not frozen, or has changed since."""
    there = frozen(out)
    if there != code_digest():
        got = "none" if there is None else "that of another diagnosis"
        raise InputError("exam", "--half locked", "the record of this diagnosis", got, "freeze it first with --freeze")
