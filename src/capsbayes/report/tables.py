"""Tables of results as data frames of texts, and their two renderers: one for the terminal, one for HTML.

A table is made once from a result, rounded and in display units. A cell is a plain text or one of the kinds below.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd
from markupsafe import Markup

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from capsbayes.status import Status


_LONG = 40  # letters, from which a cell of a page is given room
_SENTENCE = 32  # letters beyond which the text of a cell is broken into lines
_UNIT = re.compile(r"(?<=[\d±]) (?=\d|%|mN/m|mm/s|µm|µL/min|Pa s|sd\b|px\b|l\b)")  # a space that no line ends with
_FIRM = "\N{NO-BREAK SPACE}"
_SIGNS = {"alpha": "α", "delta": "δ", "eps": "ε", "theta": "θ", "mu": "µ", "Lambda": "Λ", "l": "ℓ"}


class Symbols(str):
    """Text with plain symbols, as G_s or 10^3, which HTML typesets."""


class Code(str):
    """Text to copy, as a hash."""


class Strong(str):
    """Text that stands out."""


class Number(str):
    """Text of a number, with the value by which a reader may sort it; NaN where there is none."""

    value: float

    def __new__(cls, text: str, value: float) -> Number:
        """Text and value."""
        number = super().__new__(cls, text)
        number.value = value
        return number


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str = "",
    note: str = "",
    numbers: Iterable[int] = (),
    bars: Sequence[float] = (),
) -> pd.DataFrame:
    """Return a table of texts; what is not in its cells stands in its ``attrs``.

    Headings that are all empty give no line of headings. The note stands below the table, the title above it on the
    terminal alone. Columns of `numbers` are set to the right; `bars`, one share a row, are drawn by HTML below the
    first column.
    """
    frame = pd.DataFrame([list(row) for row in rows], columns=pd.Index(range(len(head)), dtype=object), dtype=object)
    frame.columns = pd.Index(list(head), dtype=object)
    frame.attrs = {"title": title, "note": note, "numbers": tuple(numbers), "bars": tuple(bars)}
    return frame


def flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Yield name and text of each value, those of nested mappings under the names of both."""
    for name, value in values.items():
        label = f"{before}{str(name).replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from flat(value, f"{label}: ")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            yield label, ", ".join(f"{item:g}" if isinstance(item, float) else str(item) for item in value)
        else:
            yield label, f"{value:g}" if isinstance(value, float) else str(value)


def terminal_table(frame: pd.DataFrame, width: int = 80) -> Group:
    """Return the table for a terminal with title and note; brackets are shown as they are."""
    # Where it is wider than a line, the columns stand closer, their headings are broken into lines, and columns that
    # still do not fit stand below the others, with the first column again. Cells are broken only if they are sentences.
    from rich.console import Group
    from rich.text import Text

    gap, heads = 2, list(map(str, frame.columns))
    if _line(frame, heads, range(len(heads)), gap) > width:
        gap, heads = 1, [_broken(frame, number) for number in range(len(heads))]
    blocks = [_drawn(frame, heads, columns, gap) for columns in _blocks(frame, heads, gap, width)]
    between = [part for block in blocks[:-1] for part in (block, "")]
    title, note = (Text(frame.attrs[key], style="italic") for key in ("title", "note"))
    return Group(*([title] if title else []), *between, blocks[-1], *([note] if note else []), "")


def _broken(frame: pd.DataFrame, number: int) -> str:
    """Return a heading in lines no longer than the longest cell, or than its own longest word."""
    words, cells = frame.columns[number].split(), _longest(frame.iloc[:, number])
    return "\n".join(textwrap.wrap(frame.columns[number], max(1, min(cells, _SENTENCE), *map(len, words))))


def _blocks(frame: pd.DataFrame, heads: Sequence[str], gap: int, width: int) -> list[list[int]]:
    """Return the numbers of the columns that stand side by side, the first one in each."""
    blocks = [[0]]
    for column in range(1, len(heads)):
        if len(blocks[-1]) > 1 and _line(frame, heads, [*blocks[-1], column], gap) > width:
            blocks.append([0])
        blocks[-1].append(column)
    return blocks


def _line(frame: pd.DataFrame, heads: Sequence[str], columns: Sequence[int], gap: int) -> int:
    """Return the width of a line of some columns, in which sentences take `_SENTENCE` letters."""
    widths = (min(_longest([*heads[k].split("\n"), *frame.iloc[:, k]]), _SENTENCE) for k in columns)
    return sum(widths) + gap * (len(columns) - 1)


def _longest(texts: Iterable[str]) -> int:
    return max(map(len, texts), default=0)


def _drawn(frame: pd.DataFrame, heads: Sequence[str], columns: Sequence[int], gap: int) -> Table:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    style = {"box": box.SIMPLE_HEAD, "padding": (0, gap - 1, 0, 0), "pad_edge": False, "show_edge": False}
    drawn = Table(show_header=any(heads), **style)  # type: ignore[arg-type]
    for number in columns:
        whole = _longest(frame.iloc[:, number]) <= _SENTENCE
        justify: Any = "right" if number in frame.attrs["numbers"] else "left"
        drawn.add_column(Text(heads[number]), justify=justify, overflow="fold", no_wrap=whole)
    for row in frame.itertuples(index=False, name=None):
        cells = [row[number] for number in columns]
        drawn.add_row(*(Text(cell, style="bold" if isinstance(cell, Strong) else "") for cell in cells))
    return drawn


def print_parts(*parts: str | pd.DataFrame, status: Status | str | None = None, good: bool = True) -> None:
    """Print sentences and tables on the terminal, then a status in the colour of its meaning; skip empty sentences."""
    # Sentences are broken into lines as wide as the terminal, but not between a number and its unit.
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    for part in parts:
        if isinstance(part, pd.DataFrame):
            console.print(terminal_table(part, console.width))
        elif part:
            console.print(Text(_in_lines(part, console.width), style="bold" if isinstance(part, Strong) else ""))
    if status is not None:
        lines = _in_lines(f"Status: {status}", console.width)
        console.print(lines, style="green" if good else "bold red", markup=False)


def _in_lines(text: str, width: int) -> str:
    """Break a text into lines at spaces, except at those between a number and its unit."""
    wrapper = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
    return "\n".join(wrapper.fill(_UNIT.sub(_FIRM, line)) for line in text.splitlines()).replace(_FIRM, " ")


def html_table(frame: pd.DataFrame, *, sortable: bool = False) -> Markup:
    """Return the table for a page, in a box that scrolls; headings of a `sortable` one are buttons; text is escaped."""
    numbers, bars = frame.attrs["numbers"], frame.attrs["bars"]
    most = max(map(abs, bars), default=1.0)
    lines = []
    for number, row in enumerate(frame.itertuples(index=False, name=None)):
        bar = _bar(bars[number] / most) if bars else Markup()
        cells = (_cell(cell, bar if not k else Markup(), k in numbers) for k, cell in enumerate(row))
        lines.append(Markup("<tr>{}</tr>").format(Markup().join(cells)))
    head = Markup().join(_heading(text, k in numbers, sortable) for k, text in enumerate(frame.columns))
    above = Markup("<thead><tr>{}</tr></thead>\n").format(head) if any(frame.columns) else ""
    kinds = ' tabindex="0"><table class="sortable">' if sortable else "><table>"
    body, note = Markup("\n").join(lines), Markup('<p class="note">{}</p>').format(typeset(frame.attrs["note"]))
    drawn = Markup('<div class="wide"{}\n{}<tbody>\n{}\n</tbody></table></div>').format(Markup(kinds), above, body)
    return drawn + note * bool(frame.attrs["note"])


def typeset(text: str) -> Markup:
    """Return HTML of a text with plain symbols, as G_s or 10^3."""
    html = re.sub(r"\b([A-Za-z]+)_([A-Za-z0-9]+)\b", r"\1<sub>\2</sub>", str(Markup.escape(text)))
    html = re.sub(r"\^(\w+)", r"<sup>\1</sup>", html)
    return Markup(re.sub(rf"\b({'|'.join(_SIGNS)})\b", lambda sign: _SIGNS[sign[0]], html))


def _html(text: str) -> str:
    if isinstance(text, Symbols):
        return typeset(text)
    tag = {Code: "code", Strong: "b"}.get(type(text))
    return Markup("<{0}>{1}</{0}>").format(Markup(tag), text) if tag else text


def _cell(text: str, bar: Markup, number: bool) -> Markup:
    name = "number" if number else "lead" if bar else "words" if len(text) > _LONG and " " in text else ""
    kind = Markup(' class="{}"').format(name) if name else ""
    if isinstance(text, Number):
        kind += Markup(' data-value="{}"').format(f"{text.value:.9g}" if text.value == text.value else "")
    return Markup("<td{}>{}{}</td>").format(kind, _html(text), bar)


def _heading(text: str, number: bool, sortable: bool) -> Markup:
    form = '<th scope="col"{}><button type="button">{}</button></th>' if sortable else "<th{}>{}</th>"
    return Markup(form).format(Markup(' class="number"') if number else "", _html(text))


def _bar(share: float) -> Markup:
    """A bar as long as a share of its cell; hatched below zero."""
    kind = "bar below" if share < 0.0 else "bar"
    return Markup('<span class="{}" style="width: {}%"></span>').format(kind, f"{100.0 * abs(share):.1f}")
