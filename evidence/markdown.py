"""Tables in Markdown, and their places on the pages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path


def table_lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table.

    >>> list(table_lines(("law", "K_s"), [("neo-Hookean", "3")]))
    ['| law | K_s |', '| --- | --- |', '| neo-Hookean | 3 |']
    """
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"


def renew(page: Path, begin: str, end: str, table: str) -> None:
    """Put a table between the marks of a page, in place of what is there."""
    before, _, rest = page.read_text().partition(begin)
    page.write_text(f"{before}{begin}{table}{end}{rest.partition(end)[2]}")
