"""Magnification that changes along the channel, which is tilted to the focal plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import warped
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class Taper:
    """Magnification that grows along the flow, as where one end of the channel is nearer to the lens.

    To first order in the tilt nothing else changes. A lens at a distance D from a channel that is tilted by an angle
    has a taper of tan(angle) l/D; a telecentric one has none.

    Parameters
    ----------
    prior : Quantity
        Of the relative change of the magnification along a half width.
    """

    prior: Quantity = Quantity(0.0, 0.005, low=-math.inf)
    name: ClassVar[str] = "tilt of the optical axis"
    parameter: ClassVar[Parameter] = PARAMETERS["taper"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "One end of the capsule looks broader and farther out, the other narrower; L_z is the same."
    )
    separated_by: ClassVar[str] = "The walls, which are not parallel in the picture."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Magnify the downstream end of what a model predicts."""
        size = theta["taper"][:, None, None]

        def displacement(place: Floats) -> Floats:
            return np.asarray(size * place[..., :1] * place)

        return warped(model(theta, outline=True), displacement, outline=outline)
