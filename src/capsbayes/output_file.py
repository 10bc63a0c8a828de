"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Give a temporary file to write, which replaces `path` in the end; after an error nothing of it is left.

    Parameters
    ----------
    path : Path
        In an existing folder.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def replaced(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with unfinished(path) as partial:
        partial.write_text(text, encoding="utf-8")
