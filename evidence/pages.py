"""Renew what a page shows of its commands: ``python -m evidence.pages docs/membrane.md``.

The commands of the page run one after the other in a new folder with the examples, the evidence and the data; of those
whose output is shown, with ``--only WORD``, the ones that have the word. In the block after a command, each stretch
between lines of three dots is replaced by as many lines of what was printed, from the line that differs from its first
in numbers alone. What changes is told; lines of other words, and stretches that are not printed any more, are marked to
be looked at.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import pairwise, zip_longest
from pathlib import Path

from evidence.command import Arguments, path, run

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
_DOTS = re.compile(r"^\.\.\.\n", re.MULTILINE)


def blocks(page: Path) -> list[tuple[str, str]]:
    """Return language and text of each block of a page."""
    return BLOCK.findall(page.read_text())


def lines_of(text: str) -> list[list[str]]:
    """Return the words of each line of a shell block."""
    split = [shlex.split(line, comments=True) for line in text.replace("\\\n", " ").splitlines()]
    return [words for words in split if words]


def width_of(shown: str) -> str:
    """Return the columns of the terminal on which a text was printed."""
    return "80" if max(map(len, shown.splitlines()), default=0) <= 80 else "100"


def alike(line: str, other: str) -> bool:
    """Whether two lines differ in numbers and widths alone."""
    line, other = (" ".join(re.sub("─+", "─", NUMBER.sub("#", each)).split()) for each in (line, other))
    return line == other


def renewed(shown: str, printed: str) -> str:
    """Return what a page shows, with the lines that were printed now."""
    lines = [line.rstrip() for line in printed.splitlines()]
    parts = []
    for part in _DOTS.split(shown):
        old = part.rstrip("\n").splitlines()
        begin = next((i for i, line in enumerate(lines) if old and alike(line, old[0])), None)
        if begin is None:
            if old:
                print(f"!! not printed: {old[0]}")
            parts.append(part)
            continue
        new, lines = lines[begin : begin + len(old)], lines[begin + len(old) :]
        for before, after in zip_longest(old, new, fillvalue=""):
            if before != after:
                print(f"- {before}\n+ {after}" + ("" if alike(before, after) else "   !! other words"))
        parts.append("".join(f"{line}\n" for line in new))
    return "...\n".join(parts)


def renew(given: argparse.Namespace) -> int:
    """Run the commands of a page and write it anew."""
    text = given.page.read_text()
    found = list(BLOCK.finditer(text))
    with tempfile.TemporaryDirectory() as folder:
        for there in ("examples", "data", "evidence"):
            (Path(folder) / there).symlink_to(ROOT / there)
        places = list(_renewed_places(found, given.only, folder))
    for begin, end, new in reversed(places):
        text = text[:begin] + new + text[end:]
    given.page.write_text(text)
    return 0


def _renewed_places(found: list[re.Match[str]], only: str | None, folder: str) -> Iterator[tuple[int, int, str]]:
    for block, after in pairwise([*found, None]):
        shown = after if after is not None and after[1] == "text" else None
        for words in lines_of(block[2]) if block is not None and block[1] == "sh" else ():
            chosen = shown is not None and only in (None, *words)
            if words[0] == "python":
                command = words[1:]
            elif words[0] == "capsbayes" and (chosen or words[1] == "hide"):
                command = ["-m", *words]
            else:
                continue
            environment = {**os.environ, "COLUMNS": width_of(shown[2] if shown else "")}
            done = subprocess.run(
                [sys.executable, *command], cwd=folder, env=environment, check=False, stdout=subprocess.PIPE, text=True
            )
            if shown is not None and chosen:
                yield *shown.span(2), renewed(shown[2], done.stdout)


def main() -> None:
    """Renew the page that the command line names."""
    arguments = Arguments("pages", __doc__ or "")
    arguments.add_argument("page", type=path, help="a page of the documentation")
    arguments.add_argument("--only", metavar="WORD", help="renew only what commands with this word print")
    run(arguments, renew)


if __name__ == "__main__":
    main()
