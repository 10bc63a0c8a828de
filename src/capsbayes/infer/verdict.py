"""What a posterior leans on, and the status that follows from that and from its gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capsbayes.infer.checks import LEANING_SHARE, Agreement, Gate, leaning
from capsbayes.infer.prior import Prior
from capsbayes.model import TWO_SHAPES, WRINKLES, ForwardModel
from capsbayes.status import Status

__all__ = ["leanings", "verdict"]

Floats = NDArray[np.float64]

_DOUBTS = {TWO_SHAPES: Status.LEANS_ON_TWO_SHAPES, WRINKLES: Status.LEANS_ON_WRINKLES}


def leanings(draws: Mapping[str, Floats], model: ForwardModel, prior: Prior) -> dict[str, float]:
    """Share of a posterior next to the border of the model and to the ends of the prior ranges, and where doubts are.

    Parameters
    ----------
    draws : mapping of arrays
        Every quantity by name, SI.
    model : ForwardModel
    prior : Prior
    """
    place = ("capillary_number", "size_ratio")
    shares = {"model": leaning(draws, place, model.domain.contains, tuple(model.coordinates))}
    drawn = {name: np.ravel(draws[name]) for name in (*place, *model.coordinates)}
    shares |= {kind: float(np.mean(concerned)) for kind, concerned in model.caveats(drawn).items()}
    for name, one in (
        ("surface_shear_modulus", prior.surface_shear_modulus),
        ("capsule_radius", prior.capsule_radius),
    ):
        low, high = one.low, one.high
        shares[f"prior of {name}"] = leaning(draws, (name,), lambda x, a=low, b=high: (x >= a) & (x <= b))
    return shares


def verdict(
    gates: Sequence[Gate], agreed: Agreement | None, leans: Mapping[str, float], fit: Gate | None = None
) -> Status:
    """Status of a posterior, worst first: what makes the intervals wrong, then what makes them those of the border.

    `fit` says whether the outline fits a shape at all, where one was measured.
    """
    if not all(gate.passed for gate in gates):
        return Status.NOT_MIXED if agreed is not None else Status.GRID_TOO_COARSE
    if agreed is not None and not agreed.passed:
        return Status.ENGINES_DISAGREE
    if fit is not None and not fit.passed:
        return Status.OUTLINE_MISFIT
    if leans["model"] > LEANING_SHARE:
        return Status.LEANS_ON_BORDER
    if max(share for name, share in leans.items() if name not in _DOUBTS) > LEANING_SHARE:
        return Status.LEANS_ON_PRIOR
    doubts = (status for kind, status in _DOUBTS.items() if leans.get(kind, 0.0) > LEANING_SHARE)
    return next(doubts, Status.DONE)
