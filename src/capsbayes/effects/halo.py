"""Displacement of the detected edge by a halo of diffraction, or by the threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import displaced
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class Halo:
    """Displacement of all edges along their normals by the same distance.

    Parameters
    ----------
    prior : Quantity [m]
        Of the displacement.
    """

    prior: Quantity = Quantity(0.0, 0.5e-6, "m", low=-np.inf)
    name: ClassVar[str] = "halo"
    parameter: ClassVar[Parameter] = PARAMETERS["halo"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ("half_width",)
    changes: ClassVar[str] = (
        "L_z and L_a are larger by twice the displacement, L_p is the same; the relative change is largest for small "
        "capsules."
    )
    separated_by: ClassVar[str] = "A picture of a bead of known diameter."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts."""
        distance = theta["halo"] / theta["half_width"]
        return displaced(model(theta, outline=outline), distance, np.zeros_like(distance))
