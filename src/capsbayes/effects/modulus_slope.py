"""Membranes that are stiffer the larger the capsule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.effect import Kind, Theta
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity


@dataclass(frozen=True)
class ModulusSlope:
    """G_s as a power of the size; ``capillary_number`` is then that of a capsule of the reference size.

    Parameters
    ----------
    prior : Quantity
        Of the exponent.
    reference : float
        Size ratio at which G_s is stated.
    """

    prior: Quantity = Quantity(0.0, 1.0, low=-np.inf)
    reference: float = 0.9
    name: ClassVar[str] = "modulus by size"
    parameter: ClassVar[Parameter] = PARAMETERS["modulus_slope"]
    null_value: ClassVar[float] = 0.0
    kind: ClassVar[Kind] = Kind.SESSION
    circumstances: ClassVar[tuple[str, ...]] = ()
    changes: ClassVar[str] = "No shape; the apparent G_s drifts with the size."
    separated_by: ClassVar[str] = "Capsules of one size at several flow rates: their G_s is the same."

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict at the capillary number of the capsule's own G_s."""
        stiffer = np.power(theta["size_ratio"] / self.reference, theta["modulus_slope"])
        return model({**theta, "capillary_number": theta["capillary_number"] / stiffer}, outline=outline)
