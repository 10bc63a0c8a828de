"""Flow rates that are all wrong by one factor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from capsbayes.arrays import Floats
from capsbayes.effect import Theta
from capsbayes.effects.of_flow_rates import OfFlowRates
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class FlowRateError(OfFlowRates):
    """Stated flow rates larger than the true ones by one factor, by a leak, a soft tube or a wrong syringe.

    Parameters
    ----------
    prior : Quantity
        Of the relative error.
    """

    prior: Quantity = Quantity(0.0, 0.05, low=-math.inf)
    name: ClassVar[str] = "flow rate"
    parameter: ClassVar[Parameter] = PARAMETERS["flow_rate_error"]
    changes: ClassVar[str] = "No shape and no G_s; v_o is smaller than the flow rate and the size of the capsule say."
    separated_by: ClassVar[str] = "The liquid that leaves the channel in a known time, weighed."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict what the model does: shape and velocity are those of the true flow rate."""
        return model(theta, outline=outline)

    def relative_flow(self, theta: Theta) -> Floats:
        """Return the stated flow rate over the true one : (n,) array."""
        return self.factor(theta)
