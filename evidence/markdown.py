"""Tables in Markdown, and their places on the pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table, its last line without an end.

    >>> print(table(("law", "K_s"), [("neo-Hookean", "3")]))
    | law | K_s |
    | --- | --- |
    | neo-Hookean | 3 |
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def between_marks(name: str, text: str) -> str:
    """Return a text between the two marks of a page that bear a name."""
    return f"<!-- {name} -->\n{text}\n<!-- end of {name} -->"


def renew(page: Path, name: str, text: str) -> None:
    """Put a text between the marks of a page, in place of what is there."""
    begin, end = between_marks(name, "").split("\n\n")
    before, after = page.read_text().split(begin)
    page.write_text(before + between_marks(name, text) + after.split(end)[1])
