"""Effects that could hide in a session: how large each may be without contradicting the capsules."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from capsbayes.arrays import Floats
from capsbayes.diagnosis.fits import Fits, fitted
from capsbayes.diagnosis.scoring import REACH, Measured, Outcome, Scores, log_of_measured, sizes_about_the_best
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import Whitening
from capsbayes.effect import Effect, Unseen
from capsbayes.model import ForwardModel

TWO_SIGMA = 1.92
"""Fall of the log likelihood at the ends of a 95 % interval."""

_FIRST = 16.0  # part of the prior's reach on one side, at which an effect is tried first
_FURTHER = 2.0  # factor from one size to the next
_REFINED = 2  # times that sizes about the best are added
_ENOUGH = 8.0  # fall of the log likelihood, in that of an interval's end, beyond which no further size is tried


def limit_scores(
    model: ForwardModel,
    candidates: Mapping[str, Effect],
    session: Session,
    white: Whitening,
    without: Fits,
    measured: Measured,
) -> dict[str, Scores]:
    """Score effects on the capsules of a session at sizes from the null value on, as far as the capsules allow them.

    Whitening and fits are the model's; what was `measured` elsewhere counts. Effects of which nothing is seen are
    omitted.
    """
    seen = {name: effect for name, effect in candidates.items() if not isinstance(effect, Unseen)}
    return {name: _scored(model, effect, session, white, without, measured.get(name)) for name, effect in seen.items()}


def limits_table(scores: Mapping[str, Scores]) -> pd.DataFrame:
    """Return a row for each effect, that which could change G_s most first, indexed by the name of its parameter.

    Columns: ``effect``; ``low`` and ``high`` [``unit``], the 95 % interval of its size; ``modulus_at_low`` and
    ``modulus_at_high``, the median G_s with these sizes over that without the effect, NaN where no capsule has a shape;
    ``unbounded``, whether the data allow the effect up to the end of its prior.
    """
    rows = {}
    for name, found in scores.items():
        low, high = found.interval(TWO_SIGMA)
        changes = np.exp(found.log_modulus_change((low, high)))
        if np.isnan(changes).any() or not np.isfinite(found.modulus[found.null]):
            continue
        least, most = (float(found.effect.prior.ppf(share)) for share in REACH)
        null = found.effect.null_value
        rows[name] = {
            "effect": found.effect.name,
            "low": low,
            "high": high,
            "unit": found.effect.parameter.unit,
            **dict(zip(("modulus_at_low", "modulus_at_high"), map(float, changes), strict=True)),
            "unbounded": bool(low <= least < null or high >= most > null),
        }
    table = pd.DataFrame.from_dict(rows, orient="index")
    if table.empty:
        return table
    change = np.abs(np.log(table[["modulus_at_low", "modulus_at_high"]])).max(axis=1)
    return table.loc[change.sort_values(ascending=False).index]


def _scored(
    model: ForwardModel,
    effect: Effect,
    session: Session,
    white: Whitening,
    without: Fits,
    measured: tuple[float, float] | None,
) -> Scores:
    null = effect.null_value
    found = {null: Outcome.of(without)}

    def total(size: float) -> float:
        return float(found[size].log_likelihood.sum()) + log_of_measured(size, measured)

    def add(size: float, start: Floats) -> Floats:
        fits = fitted(model + effect, session, white, {effect.parameter.name: size}, start, everywhere=False)
        found[size] = Outcome.of(fits)
        return np.where(fits.settled[:, None], fits.theta, start)

    for end in (float(effect.prior.ppf(share)) for share in REACH):
        start, share = without.theta, 1.0 / _FIRST
        while share <= 1.0 and end != null:
            size = null + share * (end - null)
            start = add(size, start)
            if total(size) < max(map(total, found)) - _ENOUGH * TWO_SIGMA:
                break
            share *= _FURTHER
    for _ in range(_REFINED):
        tried = sorted(found)
        for size in sizes_about_the_best(tried, [total(each) for each in tried], null):
            nearest = min(found, key=lambda other: abs(other - size))
            add(size, found[nearest].theta)
    sizes = np.array(sorted(found))
    likelihoods, _, moduli = zip(*(found[size] for size in sizes), strict=True)
    elsewhere = np.array([log_of_measured(size, measured) for size in sizes])
    return Scores(effect, sizes, np.array(likelihoods), elsewhere, np.array(moduli))
