"""Velocities that are all wrong by one factor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import scaled
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class VelocityScale:
    """Velocities larger than the true ones by one factor, as by a wrong frame rate or a wrong distance of two pictures.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.05, low=-math.inf)
    name: ClassVar[str] = "velocity scale"
    parameter: ClassVar[Parameter] = PARAMETERS["velocity_scale"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ("flow_rate",)
    changes: ClassVar[str] = (
        "No shape; v_o is larger than the flow rate and the size of the capsule allow, and G_s of all capsules by the "
        "same factor."
    )
    separated_by: ClassVar[str] = (
        "The frame rate by a lamp of known period, or the velocity of a bead on a moving stage."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale the velocities that a model predicts."""
        factor = 1.0 + theta["velocity_scale"]
        return scaled(model(theta, outline=outline), np.ones_like(factor), factor)
