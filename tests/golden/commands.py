"""Commands run in a folder of their own, and what they print and leave behind."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import touches
from environment import REPOSITORY
from values import digest, html_text, of_netcdf

TEXTS = (".json", ".csv", ".toml", ".md", ".txt")
KEPT = (*TEXTS, ".html", ".nc")
_LONG = 40_000  # characters of a text that is kept whole
_SHORT = 120  # numbers of an array in a file that is kept whole

_PASSING = (  # what differs from run to run
    (r"\b(in|took|after) \d+(?:\.\d+)?(?:e[-+]?\d+)? ?(s|min|h|seconds|minutes|hours)\b", r"\1 <time>"),
    (r'("[\w ]*seconds": )[-+.\de]+', r"\1<time>"),
    (r"(?m)^(\| \[[^\n]*\| )\d+ \|$", r"\1<time> |"),
    (r"(?m)^(\|[^|\n]*(?:: seconds|times as long as)[^|\n]*\|[^|\n]*\|[^|\n]*\|) [-+.\de]+ \|", r"\1 <time> |"),
    (r"\b\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d)?(?:\+00:00|Z)?)?", "<date>"),
)


class Desk:
    """A folder in which commands are run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()

    def run(self, *arguments: str, keep: Sequence[str] = KEPT, program: Sequence[str] = ()) -> dict[str, Any]:
        """Run a command of the package, or another program.

        Returned are its exit status, what was printed, and by name the files that are new or changed, with what is in
        those of the endings `keep`.
        """
        before = self._files()
        told = subprocess.run(
            [*program, *arguments] if program else touches.command_line(arguments),
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
        )
        changed = [name for name, stamp in self._files().items() if before.get(name) != stamp]
        return {
            "status": told.returncode,
            "stdout": self.cleaned(told.stdout),
            "stderr": self.cleaned(told.stderr),
            "names": "\n".join(name for name in changed if ".parts" not in name),
            "files": {name: self._content(name) for name in changed if Path(name).suffix in keep},
        }

    def cleaned(self, text: str) -> str:
        """Without folders, times and dates."""
        text = text.replace(str(self.folder), "<folder>").replace(str(REPOSITORY), "<repository>")
        for found, said in _PASSING:
            text = re.sub(found, said, text)
        return "\n".join(line.rstrip() for line in text.splitlines())

    def _files(self) -> dict[str, tuple[int, int]]:
        found = {}
        for path in sorted(self.folder.rglob("*")):
            if path.is_file():
                told = os.stat(path)
                found[path.relative_to(self.folder).as_posix()] = (told.st_mtime_ns, told.st_size)
        return found

    def _content(self, name: str) -> Any:
        path = self.folder / name
        if path.suffix == ".nc":
            return of_netcdf(path, whole=_SHORT)
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".html":
            return self.cleaned(html_text(text))
        if len(text) > _LONG:
            return _shortened(self.cleaned(text))
        return self.cleaned(text)


def _shortened(text: str) -> dict[str, Any]:
    """Begin and end of a long text, and a digest of its numbers."""
    numbers = [float(one) for one in re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])", text)]
    return {"begin": text[: _LONG // 4], "end": text[-_LONG // 8 :], "numbers": digest(np.array(numbers))}
