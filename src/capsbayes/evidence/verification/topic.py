"""A topic of verification: items that are computed and stored one by one, and rows that compare them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from matplotlib.figure import Figure

from capsbayes.arrays import Floats
from capsbayes.files.input_file import parsing
from capsbayes.run import Records

Values: TypeAlias = Mapping[str, float | list[float]]
"""Result of an item: named numbers, or series of them."""

Verdict = Literal["met", "missed", "not computed", ""]


class Reference(NamedTuple):
    """A number and its source."""

    value: float
    source: str


class Target(NamedTuple):
    """Largest difference of a number from its reference, or a limit of the number itself."""

    kind: Literal["relative", "absolute", "at most", "at least"]
    bound: float

    def __str__(self) -> str:
        if self.kind == "relative":
            return f"within {100 * self.bound:.3g} %"
        return f"within {self.bound:.3g}" if self.kind == "absolute" else f"{self.kind} {self.bound:.4g}"


@dataclass(frozen=True)
class Row:
    """A computed number, compared with another.

    >>> row = Row("centre velocity", 2.001, Reference(2.0, "closed form"), Target("relative", 1e-4))
    >>> f"{row.difference:.1e}", row.verdict
    ('5.0e-04', 'missed')
    """

    quantity: str  # its name, in words or symbols
    ours: float  # NaN where it was not computed
    reference: Reference | None = None
    target: Target | None = None  # without one, the row has no verdict

    @property
    def is_relative(self) -> bool:
        """True if the difference is relative: unless the target is absolute or the reference is zero."""
        absolute = self.target is not None and self.target.kind == "absolute"
        return self.reference is not None and self.reference.value != 0.0 and not absolute

    @property
    def difference(self) -> float:
        """Difference from the reference, NaN without one."""
        if self.reference is None:
            return math.nan
        difference = self.ours - self.reference.value
        return difference / abs(self.reference.value) if self.is_relative else difference

    @property
    def verdict(self) -> Verdict:
        """Verdict on the target; empty without one."""
        if not math.isfinite(self.ours):
            return "not computed"
        if self.target is None:
            return ""
        kind, bound = self.target
        if kind == "at most":
            met = self.ours <= bound
        elif kind == "at least":
            met = self.ours >= bound
        else:
            met = abs(self.difference) <= bound
        return "met" if met else "missed"


@dataclass(frozen=True)
class Outcome:
    """End of an item: its values, or in `failed` why there are none, and its processor time [s]."""

    seconds: float
    values: Values
    failed: str = ""


@dataclass(frozen=True)
class Results:
    """Known outcomes of a topic, by item."""

    outcomes: Mapping[str, Outcome]

    @classmethod
    def read(cls, records: Records, topic: str) -> Results:
        """Read the outcomes of a topic; a file that holds something else is an InputError."""
        outcomes = {}
        with parsing(str(records.path), "results as written by verify", "remove it to compute everything anew"):
            for record in records.read():
                name = record.pop("section") if "section" in record else record.pop("topic")  # section: up to 0.1.0
                item = str(record.pop("item"))
                if name == topic:
                    found = Outcome(**record)
                    values = {str(key): np.array(value, dtype=float).tolist() for key, value in found.values.items()}
                    outcomes[item] = Outcome(float(found.seconds), values, str(found.failed))
        return cls(outcomes)

    def value(self, item: str, name: str) -> float:
        """Return one number, NaN where the item has not been computed or failed.

        >>> results = Results({"n = 4": Outcome(0.1, {"error": 1e-3})})
        >>> results.value("n = 4", "error"), results.value("n = 6", "error")
        (0.001, nan)
        """
        return float(self.series(item, name)[-1])

    def series(self, item: str, name: str) -> Floats:
        """Return a series (k,) of numbers, one NaN where the item has not been computed or failed."""
        outcome = self.outcomes.get(item)
        return np.atleast_1d(np.nan if outcome is None or outcome.failed else outcome.values[name])

    def across(self, items: Iterable[str], name: str) -> Floats:
        """Return the number `name` of several items (k,)."""
        return np.array([self.value(item, name) for item in items])


@dataclass(frozen=True)
class Topic:
    """Topic of verification."""

    name: str  # on the command line, and of the picture's file
    title: str
    about: str  # a sentence or two on what is compared
    items: Mapping[str, Callable[[], Values]]  # the computations, by the names under which their outcomes are stored
    rows: Callable[[Results], Iterable[Row]]  # of the table, from results that may be incomplete
    picture: Callable[[Results, Figure], None] | None = None  # drawn once every item has ended; a failed one is NaN

    def missing(self, results: Results) -> list[str]:
        """Return the items that have not been computed."""
        return [item for item in self.items if item not in results.outcomes]

    def failed(self, results: Results) -> dict[str, str]:
        """Return the reasons of items that failed."""
        known = {item: results.outcomes[item] for item in self.items if item in results.outcomes}
        return {item: outcome.failed for item, outcome in known.items() if outcome.failed}
