"""Shear modulus of a session, with what is not known of the effect, of its size, and of the viscosity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from capsbayes.arrays import Floats

_DRAWS = 4000
_FEWEST = 3  # capsules, whose scatter tells the error of their median
_OF_MEDIAN = 1.2533  # standard error of a median of normal values over that of their mean


class Change(Protocol):
    """What changes G_s: an effect, or something else."""

    def log_modulus_changes(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw changes of ln G_s : (count,) array."""
        ...


Explanation = Sequence[Change]
"""What acts together; empty for nothing."""


@dataclass(frozen=True)
class SessionModulus:
    """Median G_s of the capsules of a session [N/m], and its 95 % interval."""

    median: float
    low: float
    high: float


def session_modulus(
    explanations: Sequence[tuple[float, Explanation]],
    without: Floats,
    viscosity_error: float,
    seed: int,
) -> SessionModulus:
    """Return the median G_s, averaged over explanations of given weights."""
    # `without` (n,) [N/m] are the apparent G_s without an effect, NaN where the model has no shape; the relative error
    # of the viscosity is common to all capsules.
    rng = np.random.default_rng([seed, len(without)])
    weights = np.array([weight for weight, _ in explanations])
    logs = np.log(without[np.isfinite(without)])
    if len(logs) < _FEWEST:
        return SessionModulus(*(3 * [float("nan")]))
    counts = rng.multinomial(_DRAWS, weights / weights.sum())
    drawn = np.concatenate(
        [
            np.median(logs) + sum((change.log_modulus_changes(rng, count) for change in changes), start=np.zeros(count))
            for count, (_, changes) in zip(counts, explanations, strict=True)
        ]
    )
    error = _OF_MEDIAN * logs.std(ddof=1) / np.sqrt(len(logs))
    drawn += error * rng.standard_t(len(logs) - 1, _DRAWS)
    drawn += viscosity_error * rng.standard_normal(_DRAWS)
    low, median, high = np.exp(np.quantile(drawn, (0.025, 0.5, 0.975)))
    return SessionModulus(float(median), float(low), float(high))
