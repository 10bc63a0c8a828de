"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence


def table_lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table.

    >>> list(table_lines(("law", "K_s"), [("neo-Hookean", "3")]))
    ['| law | K_s |', '| --- | --- |', '| neo-Hookean | 3 |']
    """
    for cells in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(cells)} |"
