"""Bounds of a share of sessions, which have shapes in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats

_LEVEL = 0.95  # of each bound, on its side
_DRAWS = 2000


@dataclass(frozen=True)
class Share:
    """Number of sessions with a property, of how many, and bounds of the share, each of 95 % on its side."""

    # Each bound is the wider of that of independent sessions (Clopper & Pearson 1934, doi:10.1093/biomet/26.4.404) and
    # that of a bootstrap over sessions and over shapes (Owen 2007, doi:10.1214/07-AOAS122).

    counted: int
    of: int
    low: float
    high: float

    @classmethod
    def among(cls, pools: Sequence[str], shapes: Sequence[Sequence[int]], has: Sequence[bool]) -> Share:
        """Count the sessions that have the property, given pool and rows of the shapes of each."""
        from scipy.stats import binomtest

        if not len(has):
            return cls(0, 0, 0.0, 1.0)
        values = np.asarray(has, float)
        ends = binomtest(int(values.sum()), len(values)).proportion_ci(2.0 * _LEVEL - 1.0)
        low, high = np.quantile(_resampled(pools, shapes, values), (1.0 - _LEVEL, _LEVEL))
        counted = int(values.sum())
        return cls(counted, len(values), min(float(ends.low), float(low)), max(float(ends.high), float(high)))

    def __str__(self) -> str:
        if not self.of:
            return "-"
        return f"{self.counted} of {self.of}, {self.counted / self.of:.1%} [{self.low:.1%}, {self.high:.1%}]"


def _resampled(pools: Sequence[str], shapes: Sequence[Sequence[int]], values: Floats) -> Floats:
    """Return shares with sessions and shapes drawn anew, each with replacement : (draws,) array."""
    rng = np.random.default_rng(len(values))
    keys = {
        key: place
        for place, key in enumerate(
            sorted({(pool, row) for pool, rows in zip(pools, shapes, strict=True) for row in rows})
        )
    }
    part = np.zeros((len(values), len(keys)))
    for session, (pool, rows) in enumerate(zip(pools, shapes, strict=True)):
        for row in rows:
            part[session, keys[pool, row]] += 1.0 / len(rows)
    of_sessions = rng.multinomial(len(values), np.full(len(values), 1.0 / len(values)), _DRAWS)
    of_shapes = rng.multinomial(len(keys), np.full(len(keys), 1.0 / len(keys)), _DRAWS)
    weights = of_sessions * (of_shapes @ part.T)
    return np.asarray(weights @ values / np.maximum(weights.sum(axis=1), 1e-12))
