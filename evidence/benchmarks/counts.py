"""Shares of intervals that hold the truth."""

from __future__ import annotations

from collections.abc import Mapping

from scipy.stats import binomtest

LEVELS = (68, 95)  # per cent
NORMAL_ENDS = {68: 0.99446, 95: 1.95996}  # of these intervals, in standard deviations


def percent(share: float, digits: int = 0) -> str:
    return f"{share:.{digits}%}".replace("%", " %")


def covered(counts: Mapping[str, int], quantity: str, number: int) -> str:
    """Return the shares of 68 and 95 % intervals that hold the truth, the latter with its binomial 95 % interval."""
    inner, outer = (counts[f"{quantity} {level}"] for level in LEVELS)
    low, high = binomtest(outer, number).proportion_ci()
    return f"{percent(inner / number)}, **{percent(outer / number, 1)}** ({100 * low:.0f} to {100 * high:.0f})"
