"""What a model may miss: an effect, and a model with it.

An effect is a forward operator with one parameter. It may change what goes into
a model, what comes out, or both; at its null value it changes nothing. Some
effects depend on more than the parameter: on how fast the capsule was, or how
wide the channel. These circumstances are further names in ``theta``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import OutsideDatabaseError
from capsbayes.model import Domain, Doubting, ForwardModel, outline_modes_of, view_of
from capsbayes.parameters import Parameter
from capsbayes.prediction import Prediction

__all__ = ["Effect", "Extendable", "ExtendableModel", "Extended", "Held", "Kind", "circumstances_of"]

Floats = NDArray[np.float64]
Theta = Mapping[str, NDArray[np.float64]]


class Kind(Enum):
    """Whom the parameter of an effect belongs to."""

    SESSION = "one value for all capsules of a session"
    RUN = "one value for each run, as each flow rate"
    CAPSULE = "each capsule has its own"
    SPEED = "one value for all, and what it does grows with the speed of the capsule"
    STRAIN = "one value for all, and what it does grows with the strain of the membrane"


@runtime_checkable
class Effect(Protocol):
    """One effect. `capsbayes.testing.check_effect` says which promise one's own breaks."""

    @property
    def name(self) -> str:
        """What it is called in results."""
        ...

    @property
    def parameter(self) -> Parameter:
        """Its size: name in ``theta``, symbol, unit, meaning."""
        ...

    @property
    def prior(self) -> Any:
        """Frozen distribution of scipy.stats of the parameter, in SI or as a ratio."""
        ...

    @property
    def null_value(self) -> float:
        """The size at which it changes nothing."""
        ...

    @property
    def kind(self) -> Kind:
        """Whom the parameter belongs to."""
        ...

    @property
    def changes(self) -> str:
        """What it does to a capsule's picture, in one sentence."""
        ...

    @property
    def separated_by(self) -> str:
        """The measurement that would tell it from its look-alikes, in one sentence."""
        ...

    @property
    def circumstances(self) -> tuple[str, ...]:
        """What it must know of each capsule: names of `capsbayes.parameters`, in SI."""
        ...

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch with the effect; ``theta`` holds its parameter and its circumstances as well."""
        ...


def circumstances_of(model: ForwardModel) -> tuple[str, ...]:
    """What a model must know of each capsule besides Ca and a/l, and the sizes of its effects."""
    return tuple(getattr(model, "circumstances", ()))


class Extendable:
    """A forward model to which an effect can be added."""

    def __add__(self: Any, effect: Effect) -> Extended:
        """The model with an effect, which acts on what it predicts."""
        return Extended(self, effect)


@runtime_checkable
class ExtendableModel(ForwardModel, Protocol):
    """A forward model to which effects can be added, as every one that is `Extendable`."""

    def __add__(self, effect: Effect) -> Extended:
        """The model with an effect."""
        ...


@dataclass(frozen=True, eq=False)
class _Around(Extendable):
    """What a model built around another takes from it."""

    model: ForwardModel

    @property
    def view(self) -> str:
        """That of the model."""
        return view_of(self.model)

    @property
    def domain(self) -> Domain:
        """Where the model inside has an answer."""
        return self.model.domain

    def doubts(self, theta: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.bool_]]:
        """Those of the model."""
        return self.model.doubts(theta) if isinstance(self.model, Doubting) else {}


@dataclass(frozen=True, eq=False)
class Extended(_Around):
    """A forward model with an effect.

    Parameters
    ----------
    model : ForwardModel
    effect : Effect

    Examples
    --------
    >>> from capsbayes import Surrogate
    >>> from capsbayes.effects import Halo
    >>> model = Surrogate.open("square-neo-hookean") + Halo()
    >>> capsule = {"capillary_number": np.array([0.05]), "size_ratio": np.array([0.9])}
    >>> seen = model(capsule | {"halo": np.array([0.5e-6]), "half_width": np.array([25e-6])})
    >>> float((seen.axial_extent - model(capsule).axial_extent).round(6)[0])
    0.04
    """

    effect: Effect

    @property
    def name(self) -> str:
        """That of the model, and the effect."""
        return f"{self.model.name} + {self.effect.name}"

    @property
    def circumstances(self) -> tuple[str, ...]:
        """What its effects must know of each capsule."""
        return (*circumstances_of(self.model), *self.effect.circumstances)

    @property
    def sha256(self) -> str:
        """Fingerprint of the model with the effect."""
        return hashlib.sha256(f"{self.model.sha256} {self.effect!r}".encode()).hexdigest()

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch.

        Parameters
        ----------
        theta : mapping
            What the model reads; the effect's parameter, without which it has its null value; and its circumstances.
        outline : bool
            Whether to predict the mid-plane outlines too.

        Raises
        ------
        KeyError
            If the effect is at work and a circumstance is missing.
        """
        name = self.effect.parameter.name
        if name not in theta:
            return self.model(theta, outline=outline)
        missing = [key for key in self.effect.circumstances if key not in theta]
        if missing:
            raise KeyError(f"{self.effect.name}: theta lacks {', '.join(missing)}")
        return self.effect(self.model, theta, outline=outline)

    def outline_modes(self, **theta: float) -> Floats | None:
        """Own error of the outline at one point, see `outline_modes_of`: the effect's if it has one, or the model's."""
        modes = getattr(self.effect, "outline_modes", None)
        if modes is None or self.effect.parameter.name not in theta:
            try:
                return outline_modes_of(self.model, theta)
            except OutsideDatabaseError:  # the effect asks the model elsewhere, just within its border
                return None
        return np.asarray(modes(self.model, theta))


@dataclass(frozen=True, eq=False)
class Held(_Around):
    """A forward model whose effects have known sizes.

    Parameters
    ----------
    model : ForwardModel
    sizes : mapping of str to float
        By name of the effects' parameters.
    """

    sizes: Mapping[str, float]

    @property
    def circumstances(self) -> tuple[str, ...]:
        """Those of the model."""
        return circumstances_of(self.model)

    @property
    def name(self) -> str:
        """That of the model."""
        return self.model.name

    @property
    def sha256(self) -> str:
        """Fingerprint of the model with the sizes."""
        return hashlib.sha256(f"{self.model.sha256} {sorted(self.sizes.items())}".encode()).hexdigest()

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch; sizes in ``theta`` are passed over."""
        count = len(theta["capillary_number"])
        return self.model(
            {**theta, **{name: np.full(count, size) for name, size in self.sizes.items()}}, outline=outline
        )

    def outline_modes(self, **theta: float) -> Floats | None:
        """Own error of the outline at one point, see `outline_modes_of`."""
        return outline_modes_of(self.model, {**theta, **self.sizes})
