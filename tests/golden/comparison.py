"""Two records compared: numbers, words, and what one of them lacks."""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from storage import load
from values import flat

_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w])(?!\.\d)")
SIMULATED = {
    "build": "",
    "verify": "",
    "transients": "",
    "words": r"(mistake: )?(simulate|transient|build|hide|verify|examples/own_law)",
}
"""Sections and beginnings of keys whose numbers the simulator has made. These scatter from run to run."""

SCATTER = (1e-8, 1e-10)
"""How far they may, relative or absolute: residuals and slacks are small differences of large numbers."""

_HASH = re.compile(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*\d)[0-9a-f]{12,64}\b")
_MARK = "\N{NUMBER SIGN}"


@dataclass
class Found:
    """What two sections have that is not the same."""

    rtol: float
    atol: float
    simulated: re.Pattern[str] | None = None
    numbers: int = 0
    worst: float = 0.0
    differing: list[tuple[float, str, str]] = field(default_factory=list)
    texts: int = 0
    reworded: list[tuple[str, list[str]]] = field(default_factory=list)
    uncertain: list[str] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)
    further: list[str] = field(default_factory=list)
    scattering: list[float] = field(default_factory=list)

    def number(self, key: str, a: float, b: float) -> None:
        """Compare two numbers."""
        self.numbers += 1
        apart = relative_difference(a, b)
        if apart > self.rtol and not abs(a - b) <= self.atol:
            if self._scatters(key) and (apart <= SCATTER[0] or abs(a - b) <= SCATTER[1]):
                self.scattering.append(apart)
                return
            self.differing.append((apart, key, f"{a!r} -> {b!r}"))
        elif math.isfinite(apart):
            self.worst = max(self.worst, apart)

    def text(self, key: str, a: str, b: str) -> None:
        """Compare two texts, the numbers in them apart from the words."""
        self.texts += 1
        if self._scatters(key):
            a, b = (_HASH.sub("<hash>", text) for text in (a, b))
        if a == b:
            self.numbers += len(_NUMBER.findall(a))
            return
        ours, theirs = a.splitlines(), b.splitlines()
        skeletons = [[_words(line) for line in lines] for lines in (ours, theirs)]
        matcher = difflib.SequenceMatcher(None, *skeletons, autojunk=False)
        for tag, i, j, k, m in matcher.get_opcodes():
            before, after = _numbers(ours[i:j]), _numbers(theirs[k:m])
            if len(before) == len(after):
                for place, (one, other) in enumerate(zip(before, after, strict=True)):
                    self.number(f"{key} [line {i + 1}, number {place + 1}]", one, other)
            elif tag != "equal":
                self._unlike(f"{key} [lines {i + 1} to {j}]", before, after)
        if skeletons[0] != skeletons[1]:
            diff = difflib.unified_diff(ours, theirs, "first", "second", n=0, lineterm="")
            self.reworded.append((key, [line for line in diff if not line.startswith(("---", "+++"))]))

    def _scatters(self, key: str) -> bool:
        return self.simulated is not None and self.simulated.match(key) is not None

    def _unlike(self, key: str, before: list[float], after: list[float]) -> None:
        """Say which numbers came or went with the words around them."""
        gone = [one for one in before if one not in after]
        come = [one for one in after if one not in before]
        if gone or come:
            self.uncertain.append(f"{key}: gone {_listed(gone)}; new {_listed(come)}")

    @property
    def failed(self) -> bool:
        """Whether a number differs or is missing."""
        return bool(self.differing) or bool(self.lacking)


def compare(
    first: Path,
    second: Path,
    *,
    only: Sequence[str],
    rtol: float,
    atol: float,
    most: int,
    renames: Sequence[tuple[str, ...]],
    strict: bool = False,
) -> int:
    """Print how two records differ, section by section; return 1 if a number differs or is missing, else 0."""
    a, b = load(first)["sections"], load(second)["sections"]
    failed = False
    for name in dict.fromkeys([*a, *b]):
        if only and name not in only:
            continue
        if name not in a or name not in b:
            print(f"{name}: only in {first if name in a else second}\n")
            continue
        scattering = None if strict or name not in SIMULATED else re.compile(SIMULATED[name])
        found = Found(rtol, atol, scattering)
        ours = {_renamed(key, renames): value for key, value in flat(a[name]["items"])}
        theirs = dict(flat(b[name]["items"]))
        for key, value in ours.items():
            if key in theirs:
                _compare_leaf(found, key, value, theirs[key])
        found.lacking = [key for key in ours if key not in theirs]
        found.further = [key for key in theirs if key not in ours]
        _print(name, found, most)
        for one, record in ((first, a), (second, b)):
            if not record[name]["finished"]:
                print(f"  the section was not finished in {one}")
        _print_machines(a[name]["about"], b[name]["about"], found)
        print()
        failed = failed or found.failed
    return int(failed)


def relative_difference(a: float, b: float) -> float:
    """Of two numbers, over the larger; NaN is like NaN."""
    if a == b or (math.isnan(a) and math.isnan(b)):
        return 0.0
    if not (math.isfinite(a) and math.isfinite(b)):
        return math.inf
    return abs(a - b) / max(abs(a), abs(b))


def _compare_leaf(found: Found, key: str, a: Any, b: Any) -> None:
    numbers = [isinstance(one, (int, float)) and not isinstance(one, bool) for one in (a, b)]
    if all(numbers):
        found.number(key, a, b)
    elif isinstance(a, str) and isinstance(b, str):
        found.text(key, a, b)
    elif type(a) is not type(b) or a != b:
        found.numbers += 1
        found.differing.append((math.inf, key, f"{a!r} -> {b!r}"))


def _words(line: str) -> str:
    """A line without its numbers, and with single blanks, as tables widen with their numbers."""
    return re.sub(r"[─━═-]{2,}", "--", re.sub(r"\s+", " ", _NUMBER.sub(_MARK, line))).strip()


def _numbers(lines: Sequence[str]) -> list[float]:
    return [float(one) for line in lines for one in _NUMBER.findall(line)]


def _renamed(key: str, renames: Sequence[tuple[str, ...]]) -> str:
    for old, new in renames:
        key = re.sub(old, new, key)
    return key


def _listed(numbers: Sequence[float]) -> str:
    return ", ".join(f"{one:.15g}" for one in numbers[:12]) + (" ..." if len(numbers) > 12 else "") or "none"


def _print(name: str, found: Found, most: int) -> None:
    said = []
    if not found.differing:
        same = "identical" if found.worst == 0.0 else f"differ by at most {found.worst:.1e} relative"
        said.append(f"{found.numbers} numbers, {same}")
    else:
        worst = max(apart for apart, _, _ in found.differing)
        said.append(f"{len(found.differing)} of {found.numbers} numbers differ, by up to {worst:.1e} relative")
    said.append(f"{len(found.reworded)} of {found.texts} texts reworded" if found.reworded else f"{found.texts} texts")
    print(f"{name}: {'; '.join(said)}")
    if found.scattering:
        largest = f"by up to {max(found.scattering):.1e} (--strict)"
        print(f"  {len(found.scattering)} numbers of the simulator scatter, {largest}")
    for apart, key, change in sorted(found.differing, key=lambda one: -one[0])[:most]:
        print(f"  {apart:.1e}  {key}: {change}")
    _print_more(len(found.differing), most)
    for what, keys in (("not in the second", found.lacking), ("only in the second", found.further)):
        if keys:
            print(f"  {what}: {len(keys)} keys")
            together = Counter(re.sub(r"/\d+(?=/|$)", "/*", key) for key in keys)
            for key, count in together.most_common(most):
                print(f"    {key}" + (f" ({count})" if count > 1 else ""))
            _print_more(len(together), most)
    for line in found.uncertain[:most]:
        print(f"  numbers of reworded lines: {line}")
    _print_more(len(found.uncertain), most)
    for key, diff in found.reworded:
        print(f"  words of {key}")
        for line in diff[: 3 * most]:
            print(f"    {line}")
        _print_more(len(diff), 3 * most)


def _print_more(count: int, most: int) -> None:
    if count > most:
        print(f"    and {count - most} more (--most)")


def _print_machines(a: dict[str, Any], b: dict[str, Any], found: Found) -> None:
    """Where numbers differ, say what else did."""
    if found.differing:
        for key in ("processor", "python", "libraries", "environment"):
            if a.get(key) != b.get(key):
                print(f"  made with another {key}: {a.get(key)} and {b.get(key)}")
