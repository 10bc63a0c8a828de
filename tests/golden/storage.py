"""Records as files."""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from typing import Any


def load(path: Path) -> dict[str, Any]:
    """Read a record, compressed or not."""
    data = path.read_bytes()
    text = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    record: dict[str, Any] = json.loads(text)
    return record


def save(path: Path, record: dict[str, Any]) -> None:
    """Write a record; what was there stays until it is whole."""
    text = (json.dumps(record, indent=0) + "\n").encode()
    partial = path.with_name(f".{path.name}.partial")
    partial.write_bytes(gzip.compress(text, 9, mtime=0) if path.suffix == ".gz" else text)
    os.replace(partial, path)
