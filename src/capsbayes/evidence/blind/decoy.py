"""An effect that there is not: a smooth random pattern, which must explain nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.stats import norm

from capsbayes.effect import Kind, Theta
from capsbayes.evidence.blind.pattern import smooth_pattern
from capsbayes.model import ForwardModel
from capsbayes.parameters import Parameter
from capsbayes.prediction import Prediction

__all__ = ["Decoy"]


@dataclass(frozen=True)
class Decoy:
    """Edges displaced by the same smooth random function of the arc, of any size.

    Parameters
    ----------
    seed : int
        Of the function.
    """

    seed: int
    name: ClassVar[str] = "random pattern"
    parameter: ClassVar[Parameter] = Parameter("decoy", "d", "d", "-", "-", 1.0, "root mean square displacement over l")
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "Edges are displaced by a random pattern."
    separated_by: ClassVar[str] = "None: it is not in the channel."
    prior: ClassVar[Any] = norm(0.0, 0.02)

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts, and with them the ends of its lengths."""
        seen = model(theta, outline=True)
        assert seen.outline is not None, "asked for"
        moved = seen.outline.copy()
        for row in np.flatnonzero(seen.inside):
            moved[row] += theta["decoy"][row] * smooth_pattern(moved[row], self.seed)
        nose, rear = (moved[:, place, 0] - seen.outline[:, place, 0] for place in (0, moved.shape[1] // 2))
        longer = np.ptp(moved[..., 0], axis=1) - np.ptp(seen.outline[..., 0], axis=1)
        return replace(
            seen,
            axial_extent=seen.axial_extent + longer,
            axial_length=seen.axial_length + nose - rear,
            outline=moved if outline else None,
        )
