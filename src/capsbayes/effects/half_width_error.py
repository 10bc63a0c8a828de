"""Wrong half width, where the walls in the picture give the scale."""

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
class HalfWidthError(OfHalfWidth):
    """Stated half width larger than the true one, where lengths are measured against the walls in the same picture.

    Lengths over l are right then. Velocities are wrong by the same factor, and the mean velocity that follows from the
    flow rate by its square, in the other direction.

    Parameters
    ----------
    prior : Quantity
        Of the relative error, in addition to that of the experiment.
    """

    prior: Quantity = Quantity(0.0, 0.03, low=-math.inf)
    name: ClassVar[str] = "half width in the picture"
    parameter: ClassVar[Parameter] = PARAMETERS["half_width_error"]
    changes: ClassVar[str] = (
        "No shape; v_o and G_s of all capsules are wrong by the factor of the width, v_o over Q/A by its cube."
    )
    separated_by: ClassVar[str] = "A ruled slide next to the walls, or a cut through the channel under the microscope."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale the velocities that a model predicts."""
        factor = self.factor(theta)
        return scaled(model(theta, outline=outline), np.ones_like(factor), factor)
