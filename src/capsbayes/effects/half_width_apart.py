"""Wrong half width, by which lengths in metres were divided."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.effect import Theta
from capsbayes.effects.displaced import scaled
from capsbayes.effects.of_flow_rates import OfHalfWidth
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class HalfWidthApart(OfHalfWidth):
    """Stated half width larger than the true one, where the scale of the picture is known independently of it.

    Lengths over l are too small then, as with too small pixels; only the flow rate distinguishes the two, so that
    the effect is tried where it is known. The size ratio is over the stated half width.

    Parameters
    ----------
    prior : Quantity
        Of the relative error, in addition to that of the experiment.
    """

    prior: Quantity = Quantity(0.0, 0.02, low=-math.inf)
    name: ClassVar[str] = "half width stated apart"
    parameter: ClassVar[Parameter] = PARAMETERS["half_width_apart"]
    changes: ClassVar[str] = (
        "Lengths over l are too small by one factor as by the size of a pixel; v_o over Q/A too large by its square."
    )
    separated_by: ClassVar[str] = "The distance of the walls in the picture, or a cut through the channel."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict in the true channel, over the stated half width."""
        factor = self.factor(theta)
        prediction = model({**theta, "size_ratio": theta["size_ratio"] * factor}, outline=outline)
        return scaled(prediction, 1.0 / factor, np.ones_like(factor))
