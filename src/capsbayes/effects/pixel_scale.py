"""Wrong pixel size, where the half width of the channel is not measured in the same picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import scaled
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class PixelScale:
    """Wrong scale of lengths and velocity, with a half width that is known independently.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.01, low=-math.inf)
    name: ClassVar[str] = "pixel scale"
    parameter: ClassVar[Parameter] = PARAMETERS["pixel_scale"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "Lengths over l and velocity are larger by one factor; from the shape alone it resembles a swollen channel."
    )
    separated_by: ClassVar[str] = (
        "The walls in the same picture, or a ruled slide; another flow rate distinguishes it from swelling."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Scale what a model predicts."""
        factor = 1.0 + theta["pixel_scale"]
        return scaled(model(theta, outline=outline), factor, factor)
