"""An effect surrogate held at one value of its coordinate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.database import Database
from capsbayes.effect import Extendable
from capsbayes.prediction import Prediction
from capsbayes.surrogate.effect_domain import FixedDomain

if TYPE_CHECKING:
    from capsbayes.surrogate.effect_surrogate import EffectSurrogate

__all__ = ["FixedEffect"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FixedEffect(Extendable):
    """Forward model (Ca, a/l) at one value of the coordinate of an effect surrogate.

    Parameters
    ----------
    model : EffectSurrogate
    value : float
    """

    model: EffectSurrogate
    value: float

    @property
    def name(self) -> str:
        """That of the model, with the value."""
        return f"{self.model.base.name} at {self.model.coordinate} = {self.value:g}"

    @property
    def view(self) -> str:
        """That of the model."""
        return self.model.view

    @property
    def sha256(self) -> str:
        """That of the model."""
        return self.model.sha256

    @property
    def domain(self) -> FixedDomain:
        """Where it has an answer."""
        return self.model.domain.at(self.value)

    @property
    def database(self) -> Database:
        """The cases of the base."""
        return self.model.database

    def __call__(self, theta: Mapping[str, NDArray[np.float64]], *, outline: bool = False) -> Prediction:
        """Predict a batch."""
        return self.model(self._held(theta), outline=outline)

    def outline_modes(self, **theta: float) -> Floats:
        """See that of the model."""
        return self.model.outline_modes(**{**theta, self.model.coordinate: self.value})

    def doubts(self, theta: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.bool_]]:
        """Those of the model."""
        return self.model.doubts(self._held(theta))

    def _held(self, theta: Mapping[str, Any]) -> dict[str, Any]:
        return {**theta, self.model.coordinate: np.full(np.shape(theta["capillary_number"]), self.value)}
