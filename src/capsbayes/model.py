"""The contract of forward models and of effects on them."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError, OutsideDatabaseError
from capsbayes.measurement import MID_PLANE
from capsbayes.parameters import OF_THE_MEMBRANE, Parameter
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity

if TYPE_CHECKING:
    from capsbayes.database import Database
    from capsbayes.experiment import Experiment


# Effects that a forward model may miss, and that `model + effect` adds to it.
#
# An effect is a forward operator with one parameter. It may change the input of a model, its output, or both; at its
# null value it changes nothing. Some effects depend on more than the parameter, for example on the velocity of the
# capsule or the width of the channel. These circumstances are further names in ``theta``

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

    @property
    def parameter(self) -> Parameter:
        """Return the size of the effect: name in ``theta``, symbol, unit, meaning."""

    @property
    def prior(self) -> Quantity:
        """Return the distribution of the parameter, in SI or as a ratio."""

    @property
    def null_value(self) -> float:
        """Return the size at which the effect changes nothing."""

    @property
    def kind(self) -> Kind:
        """Return the owner of the parameter."""

    @property
    def changes(self) -> str:
        """Say in one sentence what the effect does to the picture of a capsule."""

    @property
    def separated_by(self) -> str:
        """Say in one sentence which measurement would distinguish it from similar effects."""

    @property
    def circumstances(self) -> tuple[str, ...]:
        """Return which of `capsbayes.model.CIRCUMSTANCES` it must know of each capsule [SI]."""

    def __call__(self, model: ForwardModel, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch with the effect; ``theta`` holds its parameter and its circumstances as well."""


@runtime_checkable
class Unseen(Protocol):
    """An effect of which neither outlines nor velocities show anything: it scales G_s, and never gains evidence."""

    @property
    def unseen_because(self) -> str:
        """Say in one sentence why it leaves no trace."""


@runtime_checkable
class HasRelativeFlow(Protocol):
    """An effect on what the stated flow rate and half width say of the mean velocity U at the capsule."""

    def relative_flow(self, theta: Theta) -> NDArray[np.float64]:
        """Return the stated flow rate over that which the stated half width and U at the capsule give : (n,) array."""


@runtime_checkable
class HasOutlineModes(Protocol):
    """An effect that states its own error of the outlines that it predicts; with any other it is that of the model."""

    def outline_modes(self, model: ForwardModel, theta: Mapping[str, float]) -> NDArray[np.float64] | None:
        """Return the own error of the outline at one point, see `ForwardModel.outline_modes`."""


# The one contract of forward models, and the models made from others by adding an effect or fixing parameters.
#
# A forward model maps parameters to a `Prediction` and declares what it stands for: the cross-section of the channel,
# the view of its outlines, its further coordinates, what it must know of each capsule, and its domain. Every part of
# the library reads these declarations and no others

TWO_SHAPES = "two shapes"
"""Caveat: another shape than that of a capsule started from rest is stable too."""

WRINKLES = "wrinkles"
"""Caveat: the membrane wrinkles, and the model answers with a smooth shape."""

UNSURE_SHAPES = "unsure shapes"
"""Caveat: the model states an error of more than `UNSURE` of a length."""

UNSURE = 0.05

CIRCUMSTANCES = ("half_width", "capsule_velocity", "mean_velocity", "viscosity", "flow_rate")
"""Properties of each capsule on which an effect may depend [SI]; every model accepts these names in ``theta``.

An effect that names ``flow_rate`` shows only where it is stated, as the other source of the mean velocity.
"""


_DECLARATIONS = (
    *("name", "sha256", "domain", "cross_section", "view"),
    *("coordinates", "effects", "circumstances", "database"),
)


class CoordinateRange(NamedTuple):
    """Lowest and highest value of a further coordinate, and the value meant where none is given.

    Where nothing is known of it, each value is as likely as any other, or each logarithm if `logarithmic`.
    """

    low: float
    high: float
    null_value: float
    logarithmic: bool = False


class Domain(ABC):
    """The set of points for which a model has an answer."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest box that holds the domain, ``((ca_min, ca_max), (size_min, size_max))`` [-]."""

    @abstractmethod
    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        """Return whether each point lies in the domain : (n,) bool array; NaN is outside.

        The further coordinates follow in the order of `ForwardModel.coordinates`; without them, their null values are
        meant.
        """

    def at(self, values: Mapping[str, float]) -> Domain:
        """Return the domain over (Ca, a/l) at given values of further coordinates."""
        del values
        return self

    def is_limit_of_existence(self, size_ratio: float) -> bool:
        """Return whether no steady shape exists above the highest Ca at this a/l, as opposed to none computed."""
        del size_ratio
        return False

    def reason(self, capillary_number: float, size_ratio: float, **coordinates: float) -> str:
        """Say why a point lies outside the domain."""
        del capillary_number, size_ratio, coordinates
        return "the model has no steady shape there"


class ForwardModel(ABC):
    """A map ``theta -> Prediction``.

    ``theta`` maps names to arrays (n,): ``"capillary_number"`` and ``"size_ratio"`` [-], and the others of `names`.
    Points outside the domain come back with ``inside`` False and NaN, never extrapolated and never an exception, so
    that a batch does not stop. A subclass sets `name`, `sha256` and `domain`, and those of the other declarations
    that differ from the defaults; `capsbayes.testing.check_model` names the promise that it breaks.

    Attributes
    ----------
    name : str
        Name of the model in results.
    sha256 : str
        Fingerprint of the data behind the model, stored with every result.
    domain : Domain
        Where the model has an answer.
    cross_section : str or None
        Cross-section of the channel, as that of an `Experiment`; None if the model holds for any.
    view : str
        View of the outlines that it predicts, one of `capsbayes.measurement.VIEWS`.
    coordinates : mapping of str to CoordinateRange
        Further coordinates besides (Ca, a/l), by name; optional in ``theta``.
    effects : tuple of str
        Names of the parameters of effects added to it; optional in ``theta``.
    circumstances : tuple of str
        Those of `CIRCUMSTANCES` on which its effects depend.
    database : Database or None
        The cases that the paper's inverse procedure uses in the model's place, if there are such.
    """

    name: str
    sha256: str
    domain: Domain
    cross_section: str | None = None
    view: str = MID_PLANE
    coordinates: Mapping[str, CoordinateRange] = MappingProxyType({})
    effects: tuple[str, ...] = ()
    circumstances: tuple[str, ...] = ()
    database: Database | None = None

    @abstractmethod
    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch.

        Parameters
        ----------
        theta : mapping
            Arrays (n,) by name.
        outline : bool
            Whether to predict the outlines too, which cost more than the lengths.

        Raises
        ------
        InputError
            On a name in ``theta`` that the model does not know, see `check_names`.
        """

    def __repr__(self) -> str:
        (low, high), (small, large) = self.domain.bounds
        shown = f"Ca {low:.3g} to {high:.3g}; a/l {small:.3g} to {large:.3g}; {self.view}"
        return f"<{type(self).__name__} {self.name}: {'; '.join((shown, *self.coordinates, *self.effects))}>"

    def __add__(self, effect: Effect) -> Extended:
        """Return the model with an effect, which acts on what it predicts."""
        return Extended(self, effect)

    def fixed(self, **values: float) -> FixedParameters:
        """Return the model with known values of further coordinates, or known sizes of effects, by name."""
        return FixedParameters(self, values)

    @property
    def names(self) -> tuple[str, ...]:
        """Names that ``theta`` may hold besides `CIRCUMSTANCES`."""
        return ("capillary_number", "size_ratio", *self.coordinates, *self.effects)

    def check_names(self, given: Iterable[str]) -> None:
        """Refuse names that the model does not know.

        Raises
        ------
        InputError
            Naming the known ones.
        """
        known = self.names
        unknown = [name for name in given if name not in known and name not in CIRCUMSTANCES]
        if unknown:
            raise InputError(self.name, "theta", f"names among {', '.join(known)}", ", ".join(map(repr, unknown)))

    def check_experiment(self, experiment: Experiment, *, viscosity_needed: bool = True) -> None:
        """Refuse an experiment of another cross-section, or of a membrane whose thickness the model cannot use.

        Where the viscosity is needed, an experiment that states the viscous tension in place of it is refused too.

        Raises
        ------
        InputError
        """
        where = experiment.source or "experiment"
        if self.cross_section not in (None, experiment.cross_section):
            expected = f'"{self.cross_section}", that of the model'
            raise InputError(where, "cross_section", expected, f'"{experiment.cross_section}"')
        if viscosity_needed and experiment.viscosity is None:
            expected = "one, and the velocity of the capsules: viscous_tension identifies one capsule only"
            raise InputError(where, "viscosity", expected, "nothing")
        if experiment.membrane_thickness is not None and "bending" not in self.coordinates:
            expected = f"none, as {self.name} has no unknown bending modulus"
            advice = "omit it, or identify with --membrane unknown (in Python with a MembraneSurrogate)"
            raise InputError(where, "membrane_thickness", expected, str(experiment.membrane_thickness), advice)

    def at(self, *, outline: bool = False, **theta: float) -> Prediction:
        """Predict one point, as ``at(capillary_number=0.05, size_ratio=0.9)``.

        Raises
        ------
        OutsideDatabaseError
            When the point lies outside the domain, with the reason.
        """
        prediction = self({name: np.array([value]) for name, value in theta.items()}, outline=outline)
        if not prediction.inside[0]:
            raise self._outside(theta)
        return prediction

    def outline_modes(self, **theta: float) -> Floats | None:
        """Return the model's own error of the outline at one point, as displacements along its normals.

        Returns
        -------
        (k, p) array [l] or None
            Independent of each other, each one standard deviation; None if the model does not state its error.

        Raises
        ------
        OutsideDatabaseError
            When the point lies outside the domain.
        """
        del theta
        return None

    def relative_area(self, theta: Mapping[str, ArrayLike]) -> Floats:
        """Return Q over U l^2, relative to that of the square or circle of the same half width : (n,) array.

        Only ``section_aspect`` and ``corner_radius`` change it, and effects on what is stated of flow rate and width.
        """
        aspect, radius = (
            np.asarray(theta.get(name, null)) for name, null in (("section_aspect", 1.0), ("corner_radius", 0.0))
        )
        return np.broadcast_to(aspect - (1.0 - np.pi / 4.0) * radius**2, np.shape(theta["capillary_number"]))

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        """Return by kind (`TWO_SHAPES`, `WRINKLES`, `UNSURE_SHAPES`) whether it concerns each point : (n,) arrays."""
        del theta
        return {}

    def joined(self, effect_database: str) -> ForwardModel | None:
        """Return the model with a shipped effect database as a further coordinate; None if it cannot be the base."""
        del effect_database
        return None

    def with_membrane(self) -> ForwardModel | None:
        """Return the model with the membrane's parameters as further coordinates; None if it cannot be the base."""
        return None

    def added_up(self, theta: Mapping[str, ArrayLike]) -> Booleans:
        """Return where effects of the membrane are added up, as they are not known together : (n,) bool array."""
        given = {name for name in OF_THE_MEMBRANE if name in theta}
        several = len(given) > 1 and not given <= set(self.coordinates)
        return np.full(np.shape(theta["capillary_number"]), several)

    def _outside(self, theta: Mapping[str, float]) -> OutsideDatabaseError:
        known = {name: theta[name] for name in self.names if name in theta and name not in self.effects}
        return OutsideDatabaseError(theta["capillary_number"], theta["size_ratio"], self.domain.reason(**known))


class Derived(ForwardModel):
    """A model made from another one: it keeps the declarations that it does not state, and asks that one."""

    def __init__(self, model: ForwardModel, **own: Any) -> None:
        self.model = model
        own.setdefault("coordinates", dict(model.coordinates))  # the default mapping cannot be pickled
        for name in _DECLARATIONS:
            setattr(self, name, own[name] if name in own else getattr(model, name))

    def _asked(self, theta: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return what the model is asked."""
        return theta

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        return self.model(self._asked(theta), outline=outline)

    def outline_modes(self, **theta: float) -> Floats | None:
        return self.model.outline_modes(**self._asked(theta))

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        return self.model.caveats(self._asked(theta))

    def relative_area(self, theta: Mapping[str, ArrayLike]) -> Floats:
        return self.model.relative_area(self._asked(theta))

    def added_up(self, theta: Mapping[str, ArrayLike]) -> Booleans:
        return self.model.added_up(self._asked(theta))


class Extended(Derived):
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

    def __init__(self, model: ForwardModel, effect: Effect) -> None:
        parameter = effect.parameter.name
        super().__init__(
            model,
            name=f"{model.name} + {effect.name}",
            sha256=hashlib.sha256(f"{model.sha256} {effect!r}".encode()).hexdigest(),
            effects=(*model.effects, parameter),
            circumstances=(*model.circumstances, *effect.circumstances),
            database=None,
        )
        self.effect = effect
        self._inner = model if parameter in model.names else _WithinEffect(model, parameter)

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch.

        Parameters
        ----------
        theta : mapping
            What the model reads; the effect's parameter, without which it has its null value; and its circumstances.
        outline : bool
            Whether to predict the outlines too.

        Raises
        ------
        InputError
            On an unknown name.
        KeyError
            If the effect is at work and a circumstance is missing.
        """
        self.check_names(theta)
        if self.effect.parameter.name not in theta:
            return self.model(theta, outline=outline)
        missing = [key for key in self.effect.circumstances if key not in theta]
        if missing:
            raise KeyError(f"{self.effect.name}: theta lacks {', '.join(missing)}")
        return self.effect(self._inner, theta, outline=outline)

    def outline_modes(self, **theta: float) -> Floats | None:
        self.check_names(theta)
        if isinstance(self.effect, HasOutlineModes) and self.effect.parameter.name in theta:
            return self.effect.outline_modes(self._inner, theta)
        try:
            return self._inner.outline_modes(**theta)
        except OutsideDatabaseError:  # the effect asks the model elsewhere, just within its border
            return None

    def relative_area(self, theta: Mapping[str, ArrayLike]) -> Floats:
        inner = self.model.relative_area(theta)
        if isinstance(self.effect, HasRelativeFlow) and self.effect.parameter.name in theta:
            arrays = {name: np.asarray(values, float) for name, values in theta.items()}
            return np.asarray(inner * self.effect.relative_flow(arrays))
        return inner

    def with_membrane(self) -> ForwardModel | None:
        joint = self.model.with_membrane()
        return None if joint is None else Extended(joint, self.effect)

    def added_up(self, theta: Mapping[str, ArrayLike]) -> Booleans:
        return (self.model.with_membrane() or self.model).added_up(theta)


def name_parts(model: str) -> tuple[str, str, tuple[str, ...]]:
    """Split the name of a model: cross-section with law, further coordinate, what is held, as ``"bending = 0.001"``."""
    plain, _, held = model.removesuffix(" (silhouettes)").partition(" at ")
    plain, _, coordinate = plain.partition(" with ")
    return plain, coordinate, tuple(held.split(", ")) if held else ()


class FixedParameters(Derived):
    """A forward model with known values, by name, of further coordinates, or known sizes of effects.

    A name that is neither a coordinate nor the parameter of an effect of the model raises an `InputError`.
    """

    def __init__(self, model: ForwardModel, values: Mapping[str, float]) -> None:
        known = (*model.coordinates, *model.effects)
        unknown = [repr(name) for name in values if name not in known]
        if unknown:
            expected = f"names among {', '.join(known)}" if known else "no names, as it has no parameters to fix"
            raise InputError(model.name, "fixed parameters", expected, ", ".join(unknown))
        places = [f"{name} = {value:g}" for name, value in values.items() if name in model.coordinates]
        super().__init__(
            model,
            name=f"{model.name} at {', '.join(places)}" if places else model.name,
            sha256=hashlib.sha256(f"{model.sha256} {sorted(values.items())}".encode()).hexdigest(),
            domain=model.domain.at(values),
            coordinates={name: ends for name, ends in model.coordinates.items() if name not in values},
            effects=tuple(name for name in model.effects if name not in values),
        )
        self.values = values

    def __call__(self, theta: Theta, *, outline: bool = False) -> Prediction:
        """Predict a batch."""
        self.check_names(theta)
        return super().__call__(theta, outline=outline)

    def with_membrane(self) -> ForwardModel | None:
        joint = self.model.with_membrane()
        return None if joint is None else FixedParameters(joint, self.values)

    def _asked(self, theta: Mapping[str, Any]) -> Mapping[str, Any]:
        count = np.shape(theta["capillary_number"])
        return {**theta, **{name: np.full(count, value)[()] for name, value in self.values.items()}}


class _WithinEffect(Derived):
    """A model as an effect sees it, which may pass on its own parameter with everything else."""

    def __init__(self, model: ForwardModel, parameter: str) -> None:
        super().__init__(model)
        self._parameter = parameter

    def joined(self, effect_database: str) -> ForwardModel | None:
        return self.model.joined(effect_database)

    def with_membrane(self) -> ForwardModel | None:
        return self.model.with_membrane()

    def _asked(self, theta: Mapping[str, Any]) -> Mapping[str, Any]:
        return {name: value for name, value in theta.items() if name != self._parameter}
