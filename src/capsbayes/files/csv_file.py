"""Tables as CSV files: read strictly, and written so that no spreadsheet runs a cell as a formula."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import read_bytes

if TYPE_CHECKING:
    import pandas as pd


_RUN_BY_SPREADSHEETS = ("=", "+", "-", "@", "\t")


def read_csv(path: str | Path, noun: str = "table") -> pd.DataFrame:
    """Read a table whose lines all have as many cells as its first line, which names the columns.

    Parameters
    ----------
    path : path
    noun : str
        What the file should be, for the message of an error.

    Returns
    -------
    pandas DataFrame
        Its index is the number of the line in the file.

    Raises
    ------
    InputError
        On a file that is missing or no such table.
    """
    import pandas as pd

    where, expected = str(path), f"a readable {noun}"
    try:
        raw = read_bytes(path, noun)
        lines = csv.reader(_text(raw), skipinitialspace=True)
        names = [name.strip() for name in next(lines, [])]
        if b"\0" in raw or not any(names):
            raise InputError(where, "", expected, "one with zero bytes" if b"\0" in raw else "no names of columns")
        for name in names:
            if names.count(name) > 1:
                raise InputError(where, name, "one column of this name", str(names.count(name)))
        numbers = []
        for line in lines:
            place = f"{where}, line {lines.line_num}"
            if line and len(line) != len(names):
                raise InputError(place, "", f"{len(names)} cells", str(len(line)))
            if [cell.strip() for cell in line] == names:
                raise InputError(place, "", "the names of the columns in the first line only", "them again")
            if any(line) or len(line) > 1:
                numbers.append(lines.line_num)
        older = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
        exact: dict[str, Any] = {"float_precision": "round_trip"} if older else {}  # the default from pandas 3.1 on
        frame = pd.read_csv(_text(raw), skipinitialspace=True, names=names, header=0, index_col=False, **exact)
        return frame.set_axis(pd.Index(numbers, name="line")[: len(frame)])
    except (ValueError, csv.Error) as error:  # pandas and csv have their own
        raise InputError(where, "", expected, " ".join(str(error).split())[:120]) from None


def _text(raw: bytes) -> io.TextIOWrapper:
    """Return the text of a file, decoded piece by piece."""
    return io.TextIOWrapper(io.BytesIO(raw), encoding="utf-8-sig", newline=None)


def read_numbers(path: str | Path, columns: Sequence[str], noun: str = "table") -> Floats:
    """Read columns of finite numbers of a table, and ignore the others.

    Returns
    -------
    (n, len(columns)) array

    Raises
    ------
    InputError
        On a column that is missing, or a cell without a number.
    """
    import pandas as pd

    table = read_csv(path, noun)
    for name in columns:
        if name not in table:
            raise InputError(str(path), name, "a column of that name", f"columns {', '.join(map(str, table))}")
    numbers = table[list(columns)].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    for row in np.flatnonzero(~np.isfinite(numbers).all(axis=1)).tolist():
        got = ", ".join(map(str, table[list(columns)].iloc[row]))
        raise InputError(f"{path}, line {table.index[row]}", "", f"numbers for {' and '.join(columns)}", got)
    return numbers


def safe_cell(text: str) -> str:
    """Return a text for a cell of a CSV file, behind an apostrophe if a spreadsheet would run it as a formula.

    Examples
    --------
    >>> safe_cell("=1+1"), safe_cell("-0.5"), safe_cell("capsule 1")
    ("'=1+1", '-0.5', 'capsule 1')
    """
    text = text.replace("\r", " ")  # which the csv module leaves without quotes
    if not text.lstrip("'").startswith(_RUN_BY_SPREADSHEETS):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def plain_cell(text: str) -> str:
    """Return the text of a cell that `safe_cell` made.

    Examples
    --------
    >>> plain_cell("'=1+1"), plain_cell("'quoted'")
    ('=1+1', "'quoted'")
    """
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
