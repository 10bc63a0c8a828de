"""Blur of nose and rear by the motion of the capsule during the exposure."""

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
class MotionBlur:
    """Edges detected at the outer ends of their blur, which is as long as the path during the exposure.

    Parameters
    ----------
    prior : Quantity [s]
        Of the exposure.
    """

    prior: Quantity = Quantity.log_uniform(1e-6, 1e-3, "s")
    name: ClassVar[str] = "motion blur"
    parameter: ClassVar[Parameter] = PARAMETERS["exposure"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SPEED
    circumstances: ClassVar[tuple[str, ...]] = ("half_width", "capsule_velocity")
    changes: ClassVar[str] = (
        "Nose and rear are blurred and lie farther out, the more so the faster the capsule; the flanks are sharp."
    )
    separated_by: ClassVar[str] = "The width of the edges at nose and flanks, or the exposure of the camera."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts."""
        path = theta["exposure"] * theta["capsule_velocity"] / theta["half_width"]
        return displaced(model(theta, outline=outline), np.zeros_like(path), 0.5 * path)
