"""Effects that could hide in a session: how large each may be without contradicting the capsules."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.scoring import REACH, Measured, Profile, Scores
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.whitening import Whitening
from capsbayes.effect import Effect, Unseen
from capsbayes.model import ForwardModel

TWO_SIGMA = 1.92
"""Fall of the log likelihood at the ends of a 95 % interval."""

_FIRST = 16.0  # part of the prior's reach on one side, at which an effect is tried first
_FURTHER = 2.0  # factor from one size to the next
_ENOUGH = 8.0  # fall of the log likelihood, in that of an interval's end, beyond which no further size is tried


def limit_scores(
    model: ForwardModel,
    candidates: Mapping[str, Effect],
    session: Session,
    white: Whitening,
    without: Fits,
    measured: Measured,
) -> dict[str, Scores]:
    """Score effects at sizes from the null value on, as far as the capsules of a session allow; omit those not seen."""
    # Whitening and fits are the model's; what was `measured` elsewhere counts.
    return {
        name: _profiled(Profile(model, effect, session, white, without, measured.get(name)))
        for name, effect in candidates.items()
        if not isinstance(effect, Unseen)
    }


def limits_table(scores: Mapping[str, Scores]) -> pd.DataFrame:
    """Return a row for each effect, that which could change G_s most first, indexed by the name of its parameter."""
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


def _profiled(profile: Profile) -> Scores:
    """Add sizes from the null value on, as far as the capsules allow them, then sizes about the best."""
    null = profile.effect.null_value
    for end in (float(profile.effect.prior.ppf(share)) for share in REACH):
        share = 1.0 / _FIRST
        while share <= 1.0 and end != null:
            size = null + share * (end - null)
            profile.add(size)
            found = profile.scores
            if found.total[found.sizes == size] < found.total.max() - _ENOUGH * TWO_SIGMA:
                break
            share *= _FURTHER
    profile.refine()
    return profile.scores
