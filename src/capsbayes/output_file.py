"""Text files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["replaced"]


def replaced(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
