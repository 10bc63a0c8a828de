"""Results as plain data: numbers in full, long arrays as digests, files by what is in them."""

from __future__ import annotations

import enum
import math
import re
from collections.abc import Iterator, Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

LONG = 1500  # numbers in an array that is kept whole
_SHOWN = 24


def plain(value: Any) -> Any:
    """Numbers, texts, lists and dictionaries of them."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "OUST":
        return [str(one) for one in value.ravel()]
    if isinstance(value, np.ndarray):
        return value.tolist() if value.size <= LONG else digest(value)
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(one) for one in (sorted(value) if isinstance(value, (set, frozenset)) else value)]
    if isinstance(value, np.bool_ | np.integer | np.floating):
        return value.item()
    return value if isinstance(value, (int, float)) else str(value)


def digest(array: Any, shown: int = _SHOWN) -> dict[str, Any]:
    """What tells one long array from another: its shape, exact sums, and some numbers from all over it."""
    flat = np.ascontiguousarray(array, dtype=np.float64).ravel()
    finite = flat[np.isfinite(flat)]
    weight = np.cos(np.arange(len(finite)))  # a sum that knows the order
    return {
        "shape": list(np.shape(array)),
        "finite": len(finite),
        "sum": math.fsum(finite),
        "sum_of_squares": math.fsum(finite * finite),
        "weighted_sum": math.fsum(weight * finite),
        "some": flat[np.unique(np.linspace(0, max(len(flat) - 1, 0), shown).astype(int))].tolist() if len(flat) else [],
    }


def flat(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers and texts with their places; an empty list or dictionary has one too."""
    if isinstance(value, dict) and value:
        for name, one in value.items():
            yield from flat(one, f"{key}/{name}" if key else name)
    elif isinstance(value, list) and value:
        for place, one in enumerate(value):
            yield from flat(one, f"{key}/{place}")
    else:
        yield key, value


def of_netcdf(path: Path, *, whole: int = LONG, skip: tuple[str, ...] = ("created",)) -> dict[str, Any]:
    """Attributes and variables of every group of a NetCDF file; arrays up to a length are kept whole."""
    import h5netcdf

    def of_group(group: Any) -> dict[str, Any]:
        found: dict[str, Any] = {"attributes": {k: _attribute(v) for k, v in group.attrs.items() if k not in skip}}
        for name, variable in group.variables.items():
            array = np.asarray(variable[...])
            if array.dtype.kind == "O":
                array = np.array([_decoded(one) for one in array.ravel()], dtype=str)
            numbers = array.dtype.kind not in "OUST"
            found[name] = digest(array) if numbers and array.size > whole else plain(array)
        return found | {f"group {name}": of_group(one) for name, one in group.groups.items()}

    with h5netcdf.File(path, "r") as file:
        return of_group(file)


def _attribute(value: Any) -> Any:
    return plain(_decoded(value) if np.ndim(value) == 0 else np.asarray(value))


def _decoded(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value


def html_text(page: str) -> str:
    """The words of a page, a line for each block; pictures leave what they show, scripts and styles nothing."""
    reader = _Words()
    reader.feed(re.sub(r"<svg\b.*?</svg>", "", page, flags=re.DOTALL))
    lines = (re.sub(r"\s+", " ", line).strip() for line in "".join(reader.found).splitlines())
    return "\n".join(line for line in lines if line)


class _Words(HTMLParser):
    _INLINE = frozenset({"a", "abbr", "b", "bdi", "code", "em", "i", "kbd", "mark", "q", "s", "small", "span"})
    _INLINE |= {"strong", "sub", "sup", "time", "u", "var"}
    _SILENT = ("script", "style")

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.found: list[str] = []
        self._silent = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in self._SILENT:
            self._silent += 1
        if tag in ("td", "th"):
            self.found.append(" | ")
        elif tag not in self._INLINE:
            self.found.append("\n")
        for name, value in attrs:
            if name in ("alt", "title", "aria-label") and value:
                self.found.append(f"\n[{name}: {value}]\n")

    def handle_endtag(self, tag: str) -> None:
        if tag in self._SILENT:
            self._silent -= 1
        if tag not in self._INLINE and tag not in ("td", "th"):
            self.found.append("\n")

    def handle_data(self, data: str) -> None:
        if not self._silent:
            self.found.append(re.sub(r"\s+", " ", data))
