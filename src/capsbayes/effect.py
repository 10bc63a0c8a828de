"""Effects that a forward model may miss, and that `model + effect` adds to it.

An effect is a forward operator with one parameter. It may change the input of a
model, its output, or both; at its null value it changes nothing. Some effects
depend on more than the parameter, for example on the velocity of the capsule or
the width of the channel. These circumstances are further names in ``theta``.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from capsbayes.parameters import Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity

if TYPE_CHECKING:
    from capsbayes.model import ForwardModel

Theta = Mapping[str, NDArray[np.float64]]


class Kind(Enum):
    """Owner of the parameter of an effect."""

    SESSION = "one value for all capsules of a session"
    SPEED = "one value for all, and what it does grows with the speed of the capsule"
    STRAIN = "one value for all, and what it does grows with the strain of the membrane"


@runtime_checkable
class Effect(Protocol):
    """An effect; `capsbayes.testing.check_effect` names the promise that it breaks."""

    @property
    def name(self) -> str:
        """Return what the effect is called in results."""
        ...

    @property
    def parameter(self) -> Parameter:
        """Return the size of the effect: name in ``theta``, symbol, unit, meaning."""
        ...

    @property
    def prior(self) -> Quantity:
        """Return the distribution of the parameter, in SI or as a ratio."""
        ...

    @property
    def null_value(self) -> float:
        """Return the size at which the effect changes nothing."""
        ...

    @property
    def kind(self) -> Kind:
        """Return the owner of the parameter."""
        ...

    @property
    def changes(self) -> str:
        """Say in one sentence what the effect does to the picture of a capsule."""
        ...

    @property
    def separated_by(self) -> str:
        """Say in one sentence which measurement would distinguish it from similar effects."""
        ...

    @property
    def circumstances(self) -> tuple[str, ...]:
        """Return which of `capsbayes.model.CIRCUMSTANCES` it must know of each capsule [SI]."""
        ...

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch with the effect; ``theta`` holds its parameter and its circumstances as well."""
        ...


@runtime_checkable
class Unseen(Protocol):
    """An effect of which neither outlines nor velocities show anything: it scales G_s, and never gains evidence."""

    @property
    def unseen_because(self) -> str:
        """Say in one sentence why it leaves no trace."""
        ...


@runtime_checkable
class HasRelativeFlow(Protocol):
    """An effect on what the stated flow rate and half width say of the mean velocity U at the capsule."""

    def relative_flow(self, theta: Theta) -> NDArray[np.float64]:
        """Return the stated flow rate over that which the stated half width and U at the capsule give : (n,) array."""
        ...


@runtime_checkable
class HasOutlineModes(Protocol):
    """An effect that states its own error of the outlines that it predicts; with any other it is that of the model."""

    def outline_modes(self, model: ForwardModel, theta: Mapping[str, float]) -> NDArray[np.float64] | None:
        """Return the own error of the outline at one point, see `ForwardModel.outline_modes`."""
        ...
