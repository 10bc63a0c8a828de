"""A file of finished results, one line of JSON each, so that an interrupted computation resumes."""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capsbayes.files.input_file import read_bytes
from capsbayes.files.output_file import refusing


@dataclass(frozen=True)
class Records:
    """Results in a file of JSON lines, appended one by one; safe to append to from many processes at once."""

    path: Path

    def add(self, record: dict[str, Any]) -> None:
        """Append a record, on a line of its own even if the last one was cut off."""
        line = json.dumps(record).encode() + b"\n"
        with refusing(self.path, "a file that can be written"), self.path.open("a+b") as file:
            if file.tell():
                file.seek(-1, 2)
                line = line if file.read() == b"\n" else b"\n" + line
            file.write(line)  # one short write: lines of several processes do not mix

    def read(self) -> list[dict[str, Any]]:
        """Return the records in their order, without lines that were cut off; none if there is no file."""
        records = []
        for line in read_bytes(self.path).splitlines() if self.path.exists() else ():
            with contextlib.suppress(ValueError, RecursionError):
                records.append(json.loads(line))
        return records
