"""One row of a table of verification: a number, what it is compared with, and what was to be reached."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

__all__ = ["Reference", "Row", "Target", "Verdict"]

Verdict = Literal["met", "missed", "not computed", ""]


class Reference(NamedTuple):
    """A number and where it comes from."""

    value: float
    source: str


class Target(NamedTuple):
    """What a number is to keep: a difference from its reference, or a limit of its own."""

    kind: Literal["relative", "absolute", "at most", "at least"]
    bound: float

    def __str__(self) -> str:
        if self.kind == "relative":
            return f"within {100 * self.bound:.3g} %"
        return f"within {self.bound:.3g}" if self.kind == "absolute" else f"{self.kind} {self.bound:.4g}"


@dataclass(frozen=True)
class Row:
    """A number that was computed, beside another.

    Parameters
    ----------
    quantity : str
        What it is, in words or symbols.
    ours : float
        The number, NaN where it was not computed.
    reference : Reference, optional
    target : Target, optional
        Without one the row only tells.

    Examples
    --------
    >>> row = Row("centre velocity", 2.001, Reference(2.0, "closed form"), Target("relative", 1e-4))
    >>> f"{row.difference:.1e}", row.verdict
    ('5.0e-04', 'missed')
    """

    quantity: str
    ours: float
    reference: Reference | None = None
    target: Target | None = None

    @property
    def difference(self) -> float:
        """From the reference: relative to it, unless the target is absolute or it is zero."""
        if self.reference is None:
            return math.nan
        apart = self.ours - self.reference.value
        relative = self.reference.value != 0.0 and (self.target is None or self.target.kind != "absolute")
        return apart / abs(self.reference.value) if relative else apart

    @property
    def verdict(self) -> Verdict:
        """Whether the target is met; nothing where there is none."""
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
