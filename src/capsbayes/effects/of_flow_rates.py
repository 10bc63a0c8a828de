"""What effects have in common that only the flow rates show: relative errors of all capsules of a session."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.effect import Kind, Theta
from capsbayes.parameters import Parameter


class OfFlowRates:
    """Relative error that all capsules of a session share, tried where flow rates are stated."""

    parameter: ClassVar[Parameter]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ("flow_rate",)

    def factor(self, theta: Theta) -> Floats:
        """Return the stated value over the true one : (n,) array."""
        return np.asarray(1.0 + theta[self.parameter.name])


class OfHalfWidth(OfFlowRates):
    """Relative error of the stated half width."""

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the area of the true cross-section over that of the stated one : (n,) array."""
        return np.asarray(self.factor(theta) ** -2.0)
