"""A topic of verification: items that are computed and kept one by one, and rows that compare them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.evidence.verification.row import Row
from capsbayes.work import Records

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Outcome", "Results", "Section", "Values"]

Values: TypeAlias = Mapping[str, float | list[float]]
"""What an item gives: named numbers, or series of them."""


@dataclass(frozen=True)
class Outcome:
    """How an item ended: its values, or in `failed` why there are none, and the processor time it took [s]."""

    seconds: float
    values: Values
    failed: str = ""


@dataclass(frozen=True)
class Results:
    """What is known of a section, by item."""

    outcomes: Mapping[str, Outcome]

    @classmethod
    def read(cls, records: Records, section: str) -> Results:
        """Read what is known of a section.

        Raises
        ------
        InputError
            If the file holds something else.
        """
        outcomes = {}
        try:
            for record in records.read():
                name, item = record.pop("section"), record.pop("item")
                if name == section:
                    outcomes[item] = Outcome(**record)
        except (AttributeError, KeyError, TypeError) as error:
            advice = "remove it to compute everything anew"
            raise InputError(str(records.path), "", "results as written by verify", repr(error), advice) from error
        return cls(outcomes)

    def value(self, item: str, name: str) -> float:
        """One number, NaN where the item has not been computed or failed.

        Examples
        --------
        >>> results = Results({"n = 4": Outcome(0.1, {"error": 1e-3})})
        >>> results.value("n = 4", "error"), results.value("n = 6", "error")
        (0.001, nan)
        """
        return float(self.series(item, name)[-1])

    def series(self, item: str, name: str) -> NDArray[np.float64]:
        """A series (k,) of numbers, one NaN where the item has not been computed or failed."""
        outcome = self.outcomes.get(item)
        return np.atleast_1d(np.nan if outcome is None or outcome.failed else outcome.values[name]).astype(float)

    def across(self, items: Iterable[str], name: str) -> NDArray[np.float64]:
        """The number `name` of several items (k,)."""
        return np.array([self.value(item, name) for item in items])


@dataclass(frozen=True)
class Section:
    """One topic.

    Parameters
    ----------
    name : str
        As asked for on the command line; also that of the picture's file.
    title : str
    about : str
        What is compared, in a sentence or two.
    items : mapping of str to callable
        What is computed, under the name it is kept by.
    rows : callable
        The rows of the table, from results that may be incomplete.
    picture : callable, optional
        Draws the results on a figure once every item has ended; a failed one is NaN.
    """

    name: str
    title: str
    about: str
    items: Mapping[str, Callable[[], Values]]
    rows: Callable[[Results], Iterable[Row]]
    picture: Callable[[Results, Figure], None] | None = None

    def missing(self, results: Results) -> list[str]:
        """The items that have not been computed."""
        return [item for item in self.items if item not in results.outcomes]

    def failed(self, results: Results) -> dict[str, str]:
        """Why items gave no values."""
        known = {item: results.outcomes[item] for item in self.items if item in results.outcomes}
        return {item: outcome.failed for item, outcome in known.items() if outcome.failed}
