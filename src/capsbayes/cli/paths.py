"""Files and folders that commands write: refused before any work is done, written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from capsbayes.errors import InputError


def check_folder(option: str, path: Path | None) -> None:
    """Refuse a folder that cannot be made, because a file has its name."""
    if path is not None and path.exists() and not path.is_dir():
        raise InputError(option, "", "a folder", f"the file {path}")


@contextlib.contextmanager
def filled(out: Path) -> Iterator[Path]:
    """A folder beside, whose files are moved into `out` in the end: an error leaves nothing half done."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".unfinished-") as folder:
        yield Path(folder)
        for made in sorted(Path(folder).iterdir()):
            os.replace(made, out / made.name)


def check_suffix(command: str, option: str, path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuse a file to write, if one is named, with another ending or in a folder that is not there."""
    if path is None:
        return
    if path.suffix not in suffixes:
        raise InputError(command, option, f"a file name that ends in {' or '.join(suffixes)}", repr(str(path)))
    if not path.parent.is_dir():
        raise InputError(command, option, "a folder that exists", repr(str(path.parent)))
