"""Readable results: one line at a prompt, a table in a notebook."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


class Readable:
    """An object with a readable `repr` and a table for notebooks, both made of what `described` returns."""

    def described(self) -> dict[str, str]:
        """Return what is worth showing, as text by name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {'; '.join(f'{name} {text}' for name, text in self.described().items())}>"

    def _repr_html_(self) -> str:
        import pandas as pd

        return as_html(type(self).__name__, pd.Series(self.described()).to_frame(), header=False)


def as_html(title: str, table: pd.DataFrame, *, header: bool = True) -> str:
    """Return a table under a title as HTML, with its text escaped."""
    return f"<p><b>{escape(title)}</b></p>{table.to_html(header=header, border=0, float_format=lambda x: f'{x:.4g}')}"
