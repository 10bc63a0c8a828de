"""Shear modulus of a session, with what is not known of the effect, of its size, and of the viscosity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from capsbayes.arrays import Floats
from capsbayes.diagnosis.scoring import Scores

_DRAWS = 4000
_OF_MEDIAN = 1.2533  # standard error of a median of normal values over that of their mean

Explanation = Sequence[Scores]
"""Scores of the effects that act together; empty for no effect."""


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
    """Return the median G_s, averaged over explanations of given weights.

    Parameters
    ----------
    explanations : sequence of (weight, scores)
    without : (n,) array [N/m]
        Apparent G_s of the capsules without an effect, NaN where the model has no shape.
    viscosity_error : float
        Relative standard error of the viscosity, which all capsules share.
    seed : int
    """
    rng = np.random.default_rng([seed, len(without)])
    weights = np.array([weight for weight, _ in explanations])
    logs = np.log(without[np.isfinite(without)])
    if not len(logs):
        return SessionModulus(*(3 * [float("nan")]))
    counts = rng.multinomial(_DRAWS, weights / weights.sum())
    drawn = np.concatenate(
        [
            np.median(logs) + sum((_changes(scores, rng, count) for scores in effects), start=np.zeros(count))
            for count, (_, effects) in zip(counts, explanations, strict=True)
        ]
    )
    drawn += _OF_MEDIAN * logs.std() / np.sqrt(len(logs)) * rng.standard_normal(_DRAWS)
    drawn += viscosity_error * rng.standard_normal(_DRAWS)
    low, median, high = np.exp(np.quantile(drawn, (0.025, 0.5, 0.975)))
    return SessionModulus(float(median), float(low), float(high))


def _changes(scores: Scores, rng: np.random.Generator, count: int) -> Floats:
    """Draw changes of ln G_s by an effect of a size drawn from its interval : (count,) array."""
    known = np.isfinite(scores.modulus)
    if known.sum() < 2:
        return np.zeros(count)
    low, high = scores.interval()
    deviate = rng.standard_normal(count)
    size = scores.size + deviate * np.where(deviate < 0.0, scores.size - low, high - scores.size)
    log_modulus = PchipInterpolator(scores.sizes[known], np.log(scores.modulus[known]))
    ends = scores.sizes[known][[0, -1]]
    null = float(log_modulus(np.clip(scores.effect.null_value, *ends)))
    return np.asarray(log_modulus(np.clip(size, *ends)) - null)
