"""Tables of users: CSV files and sheets as spreadsheets write them; written so that no cell is run as a formula."""

from __future__ import annotations

import csv
import io
import itertools
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import parsing, read_bytes, text_of

if TYPE_CHECKING:
    import pandas as pd

MISSING = frozenset(("", "na", "n/a", "#n/a", "<na>", "nan", "-nan", "null", "none"))  # in lower case

_RUN_BY_SPREADSHEETS = ("=", "+", "-", "@", "\t")
# the first of them that the first line holds
_SEPARATORS = {"\t": "a tab", ";": "';'", "|": "'|'", ",": "','", " ": "blanks"}
_OF_EXCEL = re.compile(r"\A\"?sep=.\"?\n", re.IGNORECASE)
_WITH_COMMA = re.compile(r"[+-]?(\d*,\d+|\d+,)(e[+-]?\d+)?", re.IGNORECASE)
_MOST_COLUMNS = 1000
_LARGEST_BOOK = 2**28  # bytes of an .xlsx file that is unpacked
_SUMMARIES = re.compile(
    "means?|averages?|avg|median|sd|std|stdev|stddev|sem|se|stderr|standard|variance|cv|rsd|sum|total|count|n|min|max|"
    "ci|iqr|range|quartiles?|percentiles?|quantiles?|gesamt|"
    "mittel|mittelwerte?|durchschnitt|standardabweichung|stabw|summe|anzahl|"
    "moyenne|médiane|[ée]cart|somme|media|promedio|mediana|desviación|suma|ø"
)


def read_columns(
    path: str | Path, noun: str = "table", *, texts: Collection[str] = (), unnamed: Sequence[str] = ()
) -> pd.DataFrame:
    """Read a table whose first line names the columns and whose other lines have as many cells."""
    where, raw = str(path), read_bytes(path, noun)
    with parsing(where, f"a readable {noun}"):
        if Path(path).suffix.lower() == ".xlsx":
            return _frame(_sheet(raw, where), "", where, texts, unnamed)
        text = _OF_EXCEL.sub("\n", text_of(raw, where), count=1)  # a line more, so that lines keep their numbers
        first = re.sub(r'"[^"]*"', "", text.lstrip("\n").partition("\n")[0]).strip(" ")
        separator = next((mark for mark in _SEPARATORS if mark in first), ",")
        lines = text.split("\n") if separator == " " else ()
        file = io.StringIO("\n".join(line.strip() for line in lines) if lines else text)
        reader = csv.reader(file, delimiter=separator, skipinitialspace=True, strict=True)
        return _frame(((reader.line_num, cells) for cells in reader), separator, where, texts, unnamed)


def _sheet(raw: bytes, where: str) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each row of the one sheet of an .xlsx file that is not empty."""
    try:
        import openpyxl
    except ImportError:
        advice = "pip install 'capsbayes[xlsx]', or save the table as .csv"
        raise InputError(where, "", "a reader of .xlsx files", "none is installed", advice) from None
    with zipfile.ZipFile(io.BytesIO(raw)) as packed:
        if sum(part.file_size for part in packed.infolist()) > _LARGEST_BOOK:
            raise InputError(where, "", f"a sheet of at most {_LARGEST_BOOK >> 20} MiB", "a larger one")
    sheets = {}
    with warnings.catch_warnings(action="ignore"):
        books = [openpyxl.load_workbook(io.BytesIO(raw), read_only=True, data_only=kept) for kept in (False, True)]
        for formulas, values in zip(*(book.worksheets for book in books), strict=True):
            for sheet in (formulas, values):
                sheet.reset_dimensions()  # a file may declare millions of cells that it does not hold
            rows = [list(map(_cell_text, *both)) for both in zip(formulas.values, values.rows, strict=True)]
            if any(map(any, rows)):
                sheets[formulas.title] = rows
    if len(sheets) != 1:
        raise InputError(where, "", "one sheet with a table", ", ".join(sheets) or "none", "remove the others")
    (rows,) = sheets.values()
    width = max(map(len, rows))
    yield from ((line, cells + [""] * (width - len(cells))) for line, cells in enumerate(rows, start=1))


def _cell_text(formula: Any, cell: Any) -> str:
    """Return the text of a cell of a sheet; one that states no number says why, to be refused with its row."""
    value = cell.value
    if isinstance(value, int | float) and "%" in cell.number_format:  # 1% is kept as 0.01
        return f"{100 * value:g}%"
    if value is None:
        return "" if formula is None else f"{formula}, a formula without its value"
    return str(value) if isinstance(value, str | int | float) else f"{value}, a date"


def _number(cell: str, line: int, marks: dict[str, str], *, commas: bool) -> float | None:
    """Return the number of a cell, NaN if it is missing, None if it is none; note the first of each decimal mark."""
    try:
        number = None if "_" in cell else float(cell)
    except ValueError:
        if not (commas and _WITH_COMMA.fullmatch(cell)):
            return np.nan if cell.lower() in MISSING else None
        number = float(cell.replace(",", "."))
    for mark in ",.":
        if mark in cell and mark not in marks:
            marks[mark] = f"{cell!r} in line {line}"
    return number


def _frame(
    rows: Iterable[tuple[int, list[str]]], separator: str, where: str, texts: Collection[str], unnamed: Sequence[str]
) -> pd.DataFrame:
    """Return the table of rows of cells, the first of which names the columns."""
    import pandas as pd

    marks: dict[str, str] = {}
    number, rows = partial(_number, marks=marks, commas=separator in (";", "\t", "|")), iter(rows)
    first, names = next(((line, cells) for line, cells in rows if any(map(str.strip, cells))), (0, []))
    if unnamed and len(names) == len(unnamed) and None not in [number(name.strip(), first) for name in names]:
        rows, names = itertools.chain([(first, names)], rows), list(unnamed)
    names = _checked_names([name.strip() for name in names], where)
    columns: dict[str, list[Any]] = {name: [] for name in names}
    lines: list[int] = []
    width = 0
    for line, given in rows:
        cells = [cell.strip() for cell in given]
        if not any(cells):
            cells = [""] * len(names)
        elif cells[: len(names)] == names:
            expected = "the names of the columns in the first line only"
            raise InputError(f"{where}, line {line}", "", expected, "them again")
        else:
            width = width or len(cells)  # empty cells behind the last name are in all lines, or one is a lost number
            if len(cells) != width or width < len(names) or any(cells[len(names) :]):
                got = f"{len(cells)}, separated by {_SEPARATORS[separator]}" if separator else f"{len(cells)}"
                advice = "write decimal points, or separate by semicolons" if separator == "," else ""
                if not lines and all(number(cell, line) is None for cell in cells):
                    advice = "start with the names of the columns"
                expected = f"{max(width, len(names)) if not any(cells[len(names) :]) else len(names)} cells"
                raise InputError(f"{where}, line {line}", "", expected, got, advice)
        for (name, values), cell in zip(columns.items(), cells, strict=False):
            found = (cell or np.nan) if name in texts else number(cell, line)
            values.append(cell if found is None else found)
        lines.append(line)
    if len(marks) > 1:
        got = " and ".join(marks.values())
        raise InputError(where, "", "one decimal mark, a comma or a point", got, "write all numbers alike")
    return pd.DataFrame(columns, index=pd.Index(lines, name="line", dtype=np.int64))


def _checked_names(names: list[str], where: str) -> list[str]:
    """Return the names of the columns up to the last one."""
    names = names[: max((place for place, name in enumerate(names, start=1) if name), default=0)]
    if not names:
        raise InputError(where, "", "a table", "no names of columns")
    if len(names) > _MOST_COLUMNS:
        raise InputError(where, "", f"at most {_MOST_COLUMNS} columns, as each is one number", str(len(names)))
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise InputError(where, name, "one column of this name", str(count))
    return names


def read_numbers(path: str | Path, columns: Sequence[str], noun: str = "table") -> Floats:
    """Read columns of finite numbers of a table, and ignore the others."""
    table = read_columns(path, noun)
    for name in columns:
        if name not in table:
            raise InputError(str(path), name, "a column of that name", f"columns {', '.join(map(str, table))}")
    return finite_numbers(table, columns, str(path))


def finite_numbers(table: pd.DataFrame, columns: Sequence[str], where: str) -> Floats:
    """Return columns of a table of `read_columns` as an (n, len(columns)) array, without blank rows."""
    import pandas as pd

    blank = blank_rows(table)
    numbers = table[list(columns)].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    below = ~blank & (np.cumsum(blank) > 0)
    sums = np.zeros(len(table), dtype=bool)
    for _, cells in table.items():
        if cells.dtype.kind != "f":
            sums |= np.array([is_summary(cell) for cell in cells], dtype=bool)
    for row in np.flatnonzero(below | sums | ~(blank | np.isfinite(numbers).all(axis=1)))[:1].tolist():
        cells = table[list(columns)].iloc[row]
        got = ", ".join(f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in cells)
        got += ", below a blank row" if below[row] else ", in a row of a summary" if sums[row] else ""
        raise InputError(f"{where}, line {table.index[row]}", "", f"numbers for {' and '.join(columns)}", got)
    return np.asarray(numbers[~blank])


def blank_rows(table: pd.DataFrame) -> Booleans:
    """Return which rows of a table hold nothing : (n,) array."""
    blank = np.ones(len(table), dtype=bool)
    for _, values in table.items():
        empty = values.isna().to_numpy(dtype=bool)
        if values.dtype.kind not in "fiub":
            empty = empty | np.array([isinstance(cell, str) and not cell.strip() for cell in values], dtype=bool)
        blank &= empty
    return blank


def is_summary(name: object) -> bool:
    """Return True for the name of a row in which a spreadsheet sums up those above."""
    bare = re.sub(r"\(.*?\)|\bn\s*=\s*\d+", " ", str(name).casefold().replace(".", ""))
    bare = re.sub(r"\A\s*\d+\s*%\s*\Z", "percentile", bare)
    bare = re.sub(r"\d+\s*(%|th\b)", " ", bare)
    return not any(map(str.isdigit, bare)) and any(map(_SUMMARIES.fullmatch, re.findall(r"\w+", bare)))


def safe_cell(text: str) -> str:
    """Return a text for a cell of a CSV file, behind an apostrophe if a spreadsheet would run it as a formula."""
    text = text.replace("\r", " ")  # which the csv module leaves without quotes
    if not text.lstrip("'").startswith(_RUN_BY_SPREADSHEETS):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def plain_cell(text: str) -> str:
    """Return the text of a cell that `safe_cell` made."""
    return text[1:] if text.startswith("'") and text.lstrip("'").startswith(_RUN_BY_SPREADSHEETS) else text


def text_of_table(table: pd.DataFrame, **how: Any) -> str:
    """Return a table as CSV in which no cell is a formula; `how` as of `pandas.DataFrame.to_csv`."""
    texts = [name for name, kind in table.dtypes.items() if kind.kind not in "fiub"]
    safe = {name: [safe_cell(cell) if isinstance(cell, str) else cell for cell in table[name]] for name in texts}
    return str(table.assign(**{str(name): cells for name, cells in safe.items()}).to_csv(lineterminator="\n", **how))


def text_of_numbers(columns: Sequence[str], numbers: Floats, form: str) -> str:
    """Return an (n, len(columns)) array as CSV, each number in a form as ``"%.9g"``."""
    text = io.StringIO()
    np.savetxt(text, numbers, fmt=form, delimiter=",", header=",".join(columns), comments="")
    return text.getvalue()
