"""Tables that benchmarks write into the pages, each between two marks."""

from __future__ import annotations

from pathlib import Path


def renew(page: Path, begin: str, end: str, table: str) -> None:
    """Put a table between the marks of a page, in place of what is there."""
    before, _, rest = page.read_text().partition(begin)
    page.write_text(f"{before}{begin}{table}{end}{rest.partition(end)[2]}")
