"""Pixels that are higher than wide, or wider than high, where lengths are read as if they were square."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import stretched
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class OblongPixels:
    """Wrong scale of lengths along the flow, with a half width that is read across the flow in the same picture.

    Parameters
    ----------
    prior : Quantity
        Of the height of a pixel over its width, the flow along the rows.
    """

    prior: Quantity = Quantity(1.0, 0.02)
    name: ClassVar[str] = "oblong pixels"
    parameter: ClassVar[Parameter] = PARAMETERS["pixel_aspect"]
    null_value: ClassVar[float] = 1.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = (
        "Lengths and velocity along the flow are larger by one factor; what is read across it is right."
    )
    separated_by: ClassVar[str] = "A bead or a ruled slide, of which both directions are measured on the same camera."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Stretch what a model predicts."""
        return stretched(model(theta, outline=outline), theta["pixel_aspect"])
