"""Radial distortion by the lens: barrel or pincushion."""

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
class RadialDistortion:
    """Magnification that grows with the square of the distance from the middle of the picture.

    The middle of the picture is taken to be the middle of the capsule on the axis of the channel, and the half width to
    be read next to it: there the wall itself is a half width away, so that this distance is right.

    Parameters
    ----------
    prior : Quantity
        Of the relative change of the magnification a half width away from the middle; negative for a barrel.
    """

    prior: Quantity = Quantity(0.0, 0.01, low=-math.inf)
    name: ClassVar[str] = "radial distortion"
    parameter: ClassVar[Parameter] = PARAMETERS["distortion"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "What is nearer to the middle of the picture than the walls looks too large in a barrel, what is farther too "
        "small: flanks move outwards, the ends of long capsules inwards."
    )
    separated_by: ClassVar[str] = "A ruled slide that fills the picture; the bend of straight walls."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Distort what a model predicts."""
        size = theta["distortion"][:, None, None]

        def displacement(place: Floats) -> Floats:
            return np.asarray(size * (np.sum(place**2, axis=-1, keepdims=True) - 1.0) * place)

        return warped(model(theta, outline=True), displacement, outline=outline)
