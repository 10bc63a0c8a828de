"""Wrong viscosity, which no outline shows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from capsbayes.effect import Kind, Theta
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class ViscosityError:
    """Viscosity larger than assumed; ``capillary_number`` is then that of the assumed viscosity.

    All moduli are wrong by one factor, which shapes and velocities do not show; the catalogue lists it so that
    tables state this.

    Parameters
    ----------
    prior : Quantity
        Of the relative error, in addition to that of the experiment.
    """

    prior: Quantity = Quantity(0.0, 0.1, low=-math.inf)
    name: ClassVar[str] = "viscosity"
    parameter: ClassVar[Parameter] = PARAMETERS["viscosity_error"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "Nothing visible; G_s of all capsules is wrong by one factor."
    unseen_because: ClassVar[str] = "Shapes depend on viscosity and G_s through Ca alone, which is free."
    separated_by: ClassVar[str] = "A viscometer at the temperature of the channel."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict at the capillary number of the true viscosity."""
        factor = 1.0 + theta["viscosity_error"]
        return model({**theta, "capillary_number": theta["capillary_number"] * factor}, outline=outline)
