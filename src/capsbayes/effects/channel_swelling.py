"""Widening of a soft channel by the pressure of the flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import scaled
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class ChannelSwelling:
    """Half width larger than the nominal one, in proportion to the velocity of the capsule as a measure of the flow.

    Size ratio and lengths are over the nominal half width; Ca is that of the mean velocity at the capsule.

    Parameters
    ----------
    prior : Quantity [s/m]
        Of the relative widening per velocity; PDMS widens by up to 9 %.
    """

    prior: Quantity = Quantity.log_uniform(0.05, 10.0, "s/m")
    name: ClassVar[str] = "channel swelling"
    parameter: ClassVar[Parameter] = PARAMETERS["swelling"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SPEED
    circumstances: ClassVar[tuple[str, ...]] = ("capsule_velocity",)
    changes: ClassVar[str] = "The gap is wider than the nominal one; the apparent G_s drifts with the flow rate."
    separated_by: ClassVar[str] = (
        "The distance between the walls in the picture at each flow rate, or a second distance from the outlet."
    )

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict in the wider channel, over the nominal half width."""
        wider = 1.0 + theta["swelling"] * theta["capsule_velocity"]
        prediction = model({**theta, "size_ratio": theta["size_ratio"] / wider}, outline=outline)
        return scaled(prediction, wider, np.ones_like(wider))

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the area of the swollen cross-section over that of the nominal one : (n,) array."""
        return np.asarray((1.0 + theta["swelling"] * theta["capsule_velocity"]) ** 2)
