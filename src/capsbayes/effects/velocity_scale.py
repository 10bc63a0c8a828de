"""Velocities that are all wrong by one factor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.effect import Theta
from capsbayes.effects.displaced import scaled
from capsbayes.effects.of_flow_rates import OfFlowRates
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class VelocityScale(OfFlowRates):
    """Velocities larger than the true ones by one factor, by a wrong frame rate or a wrong delay between two pictures.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.05, low=-math.inf)
    name: ClassVar[str] = "velocity scale"
    parameter: ClassVar[Parameter] = PARAMETERS["velocity_scale"]
    changes: ClassVar[str] = (
        "No shape; v_o is larger than the flow rate and the size of the capsule allow, and G_s of all capsules by the "
        "same factor."
    )
    separated_by: ClassVar[str] = (
        "The frame rate by a lamp of known period, or the velocity of a bead on a moving stage."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale the velocities that a model predicts."""
        factor = self.factor(theta)
        return scaled(model(theta, outline=outline), np.ones_like(factor), factor)
