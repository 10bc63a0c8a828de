"""Displacement of the detected edge by a halo of diffraction, or by the threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from capsbayes.effect import Kind, Theta
from capsbayes.effects.displaced import displaced
from capsbayes.effects.ranges import normal
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, Parameter
from capsbayes.prediction import Prediction


@dataclass(frozen=True)
class Halo:
    """Displacement of all edges along their normals by one length.

    Parameters
    ----------
    spread : float
        Standard deviation of the prior about zero [m].
    """

    spread: float = 0.5e-6
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

    @property
    def prior(self) -> Any:
        """Normal about zero."""
        return normal(0.0, self.spread)

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Displace the edges that a model predicts."""
        distance = theta["halo"] / theta["half_width"]
        return displaced(model(theta, outline=outline), distance, np.zeros_like(distance))
