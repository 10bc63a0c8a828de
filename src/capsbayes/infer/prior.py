"""Priors of the capsule, of the membrane and of the inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment, mean_velocity
from capsbayes.files.input_file import InputFile
from capsbayes.measurement import Measurement
from capsbayes.model import CoordinateRange, ForwardModel
from capsbayes.parameters import COORDINATES, PARAMETERS, STATED
from capsbayes.quantity import Given, Quantity, settle

# Summary of one quantity: mean, standard deviation, median, equal-tailed 68 % and 95 % intervals


@dataclass(frozen=True)
class Marginal:
    """Summary of the posterior of one quantity."""

    LEVELS: ClassVar[tuple[float, ...]] = (0.5, 0.16, 0.84, 0.025, 0.975)

    mean: float
    sd: float
    median: float
    lower_68: float  # 16 % of the probability lies below the one and above the other
    upper_68: float
    lower_95: float  # 2.5 % of the probability lies below the one and above the other
    upper_95: float

    @classmethod
    def known(cls, value: float) -> Marginal:
        """Return the summary of a number without error."""
        return cls(value, 0.0, value, value, value, value, value)

    @classmethod
    def of_draws(cls, draws: ArrayLike) -> Marginal:
        """Return the summary of equally weighted draws of any shape."""
        flat = np.ravel(draws)
        quantiles = (float(value) for value in np.quantile(flat, cls.LEVELS))
        return cls(float(flat.mean()), float(flat.std()), *quantiles)

    def contains(self, value: float, *, level: int) -> bool:
        """Return whether the 68 % or the 95 % interval holds a value."""
        lower, upper = self.ends(level)
        return lower <= value <= upper

    def ends(self, level: int) -> tuple[float, float]:
        """Return the ends of the 68 % or the 95 % interval."""
        return {68: (self.lower_68, self.upper_68), 95: (self.lower_95, self.upper_95)}[level]

    def as_dict(self) -> dict[str, float]:
        """Return the fields by name, for files."""
        return asdict(self)

    def shown(self, name: str) -> str:
        """Return median and 95 % interval in the display unit of a quantity."""
        known = PARAMETERS[name]
        low, middle, high = map(known.shown, (self.lower_95, self.median, self.upper_95))
        return f"{middle:.4g} [{low:.4g}, {high:.4g}] {known.shown_unit}".removesuffix(" -")


# Inputs with an error other than the lengths: viscosity, half width, velocity of the capsule and flow rate

LOOSEST_VELOCITY = 0.25
"""Largest relative standard error of a velocity or flow rate: beyond it the flow could be arbitrarily slow."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of one capsule other than its lengths; `area` is that of the cross-section over l^2."""

    # Where only the product mu U is known, `viscous_tension` is True: the viscosity is that product over 1 m/s, the
    # velocity is 1 m/s, and the posterior density takes v_o/U as one, so that G_s = mu U / Ca. Where the velocity was
    # not measured, it is NaN, and the flow rate alone tells U.

    viscosity: Quantity
    half_width: Quantity
    capsule_velocity: Quantity
    flow_rate: Quantity | None = None
    area: float = 4.0
    viscous_tension: bool = False

    @classmethod
    def of(cls, measurement: Measurement, experiment: Experiment) -> Inputs:
        """Gather the inputs from the measurement and the experiment."""
        return cls.of_experiment(experiment).with_velocity_of(measurement)

    @property
    def by_flow_rate(self) -> bool:
        """True if the flow rate is the only source of U."""
        return self.flow_rate is not None and bool(np.isnan(self.capsule_velocity.value))

    @property
    def first_source(self) -> Inputs:
        """The same without a flow rate that is a second source of U."""
        return self if self.by_flow_rate else replace(self, flow_rate=None)

    def mean_velocity(self, velocity_ratio: ArrayLike) -> Floats:
        """Return U [m/s] by the central values of the inputs: of the flow rate alone if the velocity is missing."""
        if self.flow_rate is not None and self.by_flow_rate:
            return np.full(np.shape(velocity_ratio), self.flow_rate.value / (self.area * self.half_width.value**2))
        ratio = np.ones(np.shape(velocity_ratio)) if self.viscous_tension else velocity_ratio
        return mean_velocity(capsule_velocity=self.capsule_velocity.value, velocity_ratio=ratio)

    @classmethod
    def of_experiment(cls, experiment: Experiment) -> Inputs:
        """Return the inputs that many capsules share, with NaN as the velocity."""
        velocity, area = Quantity(np.nan, unit="m/s"), AREAS[experiment.cross_section]
        if experiment.viscous_tension is not None:
            velocity = Quantity(1.0, unit="m/s")
            return cls(experiment.viscous_tension, experiment.half_width, velocity, area=area, viscous_tension=True)
        return cls(experiment.viscosity, experiment.half_width, velocity, area=area)

    def with_velocity_of(self, measurement: Measurement) -> Inputs:
        """Return the same viscosity and half width with the velocity of a capsule and the flow rate."""
        where = measurement.source or "measurement"
        if not measurement.status.ok:
            raise InputError(where, "status", "a measurement that ended as it should", str(measurement.status))
        if self.viscous_tension:
            if measurement.flow_rate is not None:
                raise InputError(where, "flow_rate", "none: the experiment states viscous_tension", "one")
            return self
        rate = measurement.flow_rate and Quantity(measurement.flow_rate, measurement.flow_rate_error or 0.0, "m^3/s")
        by_rate = rate is not None and measurement.capsule_velocity is None
        if by_rate and not measurement.flow_rate_error:
            expected = "a standard error, as no velocity is stated"
            raise InputError(where, "flow_rate", expected, "none")
        velocity = self.capsule_velocity if by_rate else measurement.known_velocity
        for key, seen in (("capsule_velocity", velocity), ("flow_rate", rate)):
            if seen is not None and seen.error > LOOSEST_VELOCITY * seen.value:
                expected = f"a standard error below {LOOSEST_VELOCITY:.0%} of the {key.rpartition('_')[2]}"
                raise InputError(where, key, expected, f"{seen.error / seen.value:.0%}")
        return replace(self, capsule_velocity=velocity, flow_rate=rate)


# Prior distributions of physical quantities, and the further coordinates of a model with their priors.
#
# G_s is log-uniform and a uniform by default, each over a range; a user can give any distribution. The mean velocity U
# of the flow is log-uniform without limits. They are independent of each other, of the inputs (viscosity mu, half width
# l) and of the further coordinates of the model. The posterior is computed in (log Ca, a/l, v_o). With
#
#     log G_s = log mu + log U - log Ca,    a = l (a/l),    log U = log v_o - log r(Ca, a/l),    r = v_o/U
#
# the determinant of the derivatives of (log G_s, a, log U) by (log Ca, a/l, v_o) is -l/v_o: those of r cancel. So the
# prior density in (log Ca, a/l, v_o) is p(log G_s) p(a) l / v_o, and its support is the domain of the model

LEAST_COVERED = 0.8  # of the mass of the prior of a coordinate, by the range of the model

NARROWEST = 1e-3  # standard deviation of a prior of G_s or a over its mean, below which no engine resolves it

_RANGES = {"log-uniform": Quantity.log_uniform, "uniform": Quantity.uniform}
LIMITED = ("surface_shear_modulus", "capsule_radius")
THICKNESS = "membrane_thickness"  # name of the prior that takes the place of that of the bending modulus
_DEFAULTS = Quantity.log_uniform(1e-4, 10.0, "N/m"), Quantity.uniform(1e-6, 1e-3, "m")


@dataclass(frozen=True, init=False)
class Prior:
    """Independent priors of the shear modulus, of the radius and of the further coordinates of the model.

    Each may be given in any form that `Quantity.of` reads: ``"log-uniform 1 .. 1000 mN/m"``, ``"20 .. 80 mN/m"``,
    ``"50 +/- 10 mN/m"``, ``"log-normal 50 +/- 10 mN/m"`` or a frozen distribution of scipy.stats.

    Parameters
    ----------
    surface_shear_modulus : Quantity [N/m]
        Default: log-uniform from 0.1 mN/m to 10 N/m, which contains the known microcapsules with two decades to spare.
    capsule_radius : Quantity [m]
        Default: uniform from 1 um to 1 mm; the domain of the model is narrower.
    coordinates : mapping of str to Quantity
        Priors of further coordinates of the model, as ``{"pre_inflation": "0 .. 0.1"}``. Default: uniform over the
        range of the model, or log-uniform where the model declares the coordinate logarithmic. A
        ``"membrane_thickness"`` [m], known or not, takes the place of the prior of ``"bending"``, see `with_thickness`.
    G_s, a : Quantity, optional
        In place of `surface_shear_modulus` and `capsule_radius`.

    Raises
    ------
    InputError
        If G_s or a is a known number or nearly so, or stated twice, or a limit is not positive.

    Examples
    --------
    >>> Prior(G_s="log-uniform 1 .. 1000 mN/m").surface_shear_modulus.high
    1.0
    """

    surface_shear_modulus: Quantity
    capsule_radius: Quantity
    coordinates: Mapping[str, Quantity]

    def __init__(
        self,
        surface_shear_modulus: Given = None,
        capsule_radius: Given = None,
        coordinates: Mapping[str, Given] | None = None,
        *,
        G_s: Given = None,
        a: Given = None,
    ) -> None:
        limited = {}
        stated = (surface_shear_modulus, G_s), (capsule_radius, a)
        for name, both, default in zip(LIMITED, stated, _DEFAULTS, strict=True):
            given = [each for each in both if each is not None] or [default]
            if len(given) > 1:
                raise InputError("prior", name, f"one statement of {PARAMETERS[name].symbol}", "two")
            limited[name] = _uncertain(given[0], name, "prior", name)
        read = {name: _coordinate(quantity, "prior", name) for name, quantity in (coordinates or {}).items()}
        if THICKNESS in read and "bending" in read:
            raise InputError("prior", f"bending, {THICKNESS}", "one of the two, as B = (t/a)^2 / 3", "both")
        settle(self, coordinates=read, **limited)

    @property
    def both(self) -> tuple[Quantity, Quantity]:
        """Priors of G_s and a."""
        return self.surface_shear_modulus, self.capsule_radius

    @property
    def is_general(self) -> bool:
        """True unless G_s and a have ranges, whose densities are powers between two limits."""
        return not all(prior.is_range for prior in self.both)

    @property
    def uncertain(self) -> dict[str, Quantity]:
        """Priors of the further coordinates, by name, without a thickness of the membrane that is known."""
        return {name: quantity for name, quantity in self.coordinates.items() if not quantity.known}

    @classmethod
    def read(cls, path: str | Path, default: Prior | None = None) -> Prior:
        """Read the table ``[prior]`` of a measurement's file; what it does not state is that of the default.

        The keys of G_s and a hold a text that `Quantity.read` reads, as ``"50 +/- 10 mN/m"``, or a table
        ``{ distribution = "log-uniform", low = "1 mN/m", high = "1 N/m" }``; that of a further coordinate of the model
        a text, see `coordinate_prior`.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        stated, where = file.table("prior", optional=(*LIMITED, *COORDINATES)), str(path)
        ranges: dict[str, Any] = {
            key: _distribution(where, f"prior.{key}", stated[key]) for key in LIMITED if key in stated
        }
        texts = {key: value for key, value in stated.items() if key in COORDINATES}
        return replace(default or cls(), **ranges).with_texts(texts, where=f"{where}: prior")

    def with_texts(self, texts: Mapping[str, object], *, where: str = "prior") -> Prior:
        """Return a copy with other priors, in text form: of G_s and a, and of coordinates, see `coordinate_prior`."""
        own = {name: _distribution(where, name, texts[name]) for name in LIMITED if name in texts}
        read = {name: coordinate_prior(texts[name], where=where, key=name) for name in texts if name not in own}
        return replace(self, **own, coordinates={**self.coordinates, **read})

    def described(self) -> dict[str, dict[str, Any]]:
        """Return the priors of G_s and a in SI, for reports and files."""
        found: dict[str, dict[str, Any]] = {}
        for name, known in zip(LIMITED, self.both, strict=True):
            found[name] = {"distribution": known.shape, "low": known.low, "high": known.high, "unit": known.unit}
            if not known.is_range:
                found[name] |= {"mean": known.mean, "sd": known.sd, "record": known.as_record()}
        return found

    @classmethod
    def of_record(cls, described: Mapping[str, Mapping[str, Any]], coordinates: Mapping[str, Any]) -> Prior:
        """Return the prior that `described` gave, with records of the coordinates' quantities."""
        stated = [described[name] for name in LIMITED]
        modulus, radius = (
            Quantity.of_record(table["record"], table["unit"])
            if "record" in table
            else _RANGES[table["distribution"]](table["low"], table["high"])
            for table in stated
        )
        known = {name: Quantity.of_record(record, PARAMETERS[name].si) for name, record in coordinates.items()}
        return cls(modulus, radius, known)

    def with_thickness(self, experiment: Experiment) -> Prior:
        """Return a copy with the thickness of the membrane that an experiment states, if it states one.

        Raises
        ------
        InputError
            If the bending modulus has a prior already, or the thickness another one.
        """
        stated = experiment.membrane_thickness
        if stated is None or self.coordinates.get(THICKNESS) == stated:
            return self
        for name in ("bending", THICKNESS):
            if name in self.coordinates:
                expected = f"one statement of what is known of the {PARAMETERS[name].meaning}"
                got = f"{stated}, and {self.coordinates[name]} for {name}"
                raise InputError(experiment.source or "experiment", THICKNESS, expected, got)
        return replace(self, coordinates={**self.coordinates, THICKNESS: stated})


def coordinate_prior(text: object, *, where: str, key: str) -> Quantity:
    """Return the distribution of a coordinate from its text form."""
    return _coordinate(text if isinstance(text, str) else repr(text), where, key)


def _coordinate(given: Given, where: str, key: str) -> Quantity:
    if key == THICKNESS:
        return Quantity.of(given, key, where=where)
    expected = 'a range as "0 .. 0.1" or a value with its error as "0.03 +/- 0.01"'
    try:
        read = Quantity.of(given, key, where=where, units=("",), signed=True)
    except InputError as error:
        raise InputError(where, key, expected, error.got, error.advice) from None
    if read.known:
        raise InputError(where, key, expected, repr(given))
    return read


def _uncertain(given: Given, name: str, where: str, key: str) -> Quantity:
    """Return the prior of G_s or a; one that is known or nearly so is refused."""
    read = (Quantity.of_text if isinstance(given, str) else Quantity.of)(given, name, where=where, key=key)
    if read.known or (read.is_range and read.low <= 0.0):
        expected = 'a distribution, as "low .. high" with 0 < low < high, or "mean +/- error"'
        raise InputError(where, key, expected, repr(given) if isinstance(given, str) else str(read))
    if not read.is_range and read.sd < NARROWEST * read.mean:
        raise InputError(where, key, f"a standard error of at least {NARROWEST:.1%}", str(read))
    return read


def _distribution(where: str, key: str, stated: object) -> Quantity:
    """Return the prior of G_s or a from a text, or from a table of a file that states a range."""
    name = key.rpartition(".")[2]
    if isinstance(stated, str):
        return _uncertain(stated, name, where, key)
    example = STATED[name].example
    if not isinstance(stated, Mapping) or set(stated) != {"distribution", "low", "high"}:
        wanted = f'{{ distribution = "log-uniform", low = "{example}", high = "{example}" }} or a text "low .. high"'
        raise InputError(where, key, wanted, repr(stated))
    if stated["distribution"] not in _RANGES:
        raise InputError(where, f"{key}.distribution", " or ".join(_RANGES), repr(stated["distribution"]))
    low, high = (Quantity.of_text(stated[end], name, where=where, key=f"{key}.{end}") for end in ("low", "high"))
    if not low.value < high.value:
        raise InputError(where, key, "low < high", f"{stated['low']!r}, {stated['high']!r}")
    return _RANGES[stated["distribution"]](low.value, high.value, PARAMETERS[name].si)


@dataclass(frozen=True, eq=False)
class Coordinate:
    """A coordinate and its prior, cut to the range of the model."""

    name: str
    distribution: Quantity  # before the cut
    low: float  # of the model
    high: float
    by_thickness: bool = False  # the distribution is of a thickness [m], which tells B together with a

    @classmethod
    def all_of(cls, model: ForwardModel, prior: Prior) -> tuple[Coordinate, ...]:
        """Return the coordinates of a model in their order; a prior that is not stated is that of `CoordinateRange`."""
        check_coordinates(model, prior)
        return tuple(cls._of(name, ends, prior) for name, ends in model.coordinates.items())

    @classmethod
    def _of(cls, name: str, ends: CoordinateRange, prior: Prior) -> Coordinate:
        low, high = ends.low, ends.high
        if name == "bending" and THICKNESS in prior.coordinates:
            return cls(name, prior.coordinates[THICKNESS], low, high, by_thickness=True)
        if name not in prior.coordinates:
            known = Quantity.log_uniform if ends.logarithmic else Quantity.uniform
            return cls(name, known(low, high), low, high)
        made = cls(name, prior.coordinates[name], low, high)
        if made.covered < LEAST_COVERED:
            expected = f"a distribution within the range of the model, {low:g} to {high:g}"
            raise InputError("prior", name, expected, f"one with {made.covered:.0%} of its mass there")
        return made

    @property
    def key(self) -> str:
        """Name of what the distribution is of."""
        return THICKNESS if self.by_thickness else self.name

    @cached_property
    def covered(self) -> float:
        """Probability of the range under the distribution."""
        return float(self.distribution.cdf(self.high) - self.distribution.cdf(self.low))

    @cached_property
    def _below(self) -> float:
        return float(self.distribution.cdf(self.low))

    def values(self, shares: ArrayLike) -> Floats:
        """Return the values below which given shares of the prior lie."""
        if self.distribution.known:
            return np.full(np.shape(shares), self.distribution.value)
        if self.by_thickness:
            return self.distribution.ppf(shares)
        shares = self._below + np.asarray(shares) * self.covered
        return np.clip(self.distribution.ppf(shares), self.low, self.high)

    def shares(self, values: ArrayLike) -> Floats:
        """Return the shares of the prior that lie below given values: the inverse of `values`."""
        below = self.distribution.cdf(values)
        return np.asarray(below if self.by_thickness else (below - self._below) / self.covered)

    def log_density(self, values: ArrayLike) -> Floats:
        """Return the log of the prior density, -inf beyond the range."""
        values = np.asarray(values, dtype=np.float64)
        within = (values >= self.low) & (values <= self.high)
        return np.where(within, self.distribution.logpdf(values) - np.log(self.covered), -np.inf)


def check_coordinates(model: ForwardModel, prior: Prior) -> None:
    """Refuse a prior of a name that is no coordinate of the model, naming those that are."""
    names = tuple(model.coordinates)
    for other in prior.coordinates:
        if ("bending" if other == THICKNESS else other) not in names:
            known = f"a coordinate of {model.name}" + (f" ({', '.join(names)})" if names else "")
            raise InputError("prior", other, known, f"a model of ({', '.join(('Ca', 'a/l', *names))})")


# What is known of a membrane: its law, moduli, inflation and thickness, as a model and the priors of what is left

UNKNOWN = "unknown"

LAWS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        UNKNOWN: {},
        "neo-Hookean": {"area_dilation_modulus": 3.0, "strain_hardening": 0.0},
        "Blatz-Ko": {"strain_hardening": 0.0},
        "Skalak": {"strain_hardening": 1.0},
    }
)
"""Values that a law has of K and h, see `capsbayes.physics.membrane.GeneralLaw`."""


@dataclass(frozen=True)
class Membrane:
    """What is known of the membrane of a capsule.

    Each number is known, uncertain, or unknown: ``3.0``, ``"1.5 +/- 0.3"`` or ``"1 .. 2"``, None or ``"unknown"``. What
    is known is fixed in the model, what is uncertain has this prior, what is unknown the default one.

    Parameters
    ----------
    law : str
        One of `LAWS`, in any case.
    area_dilation_modulus : Quantity, optional [G_s]
        Area dilation modulus K = K_s / G_s.
    strain_hardening : Quantity, optional [-]
        Share h of Skalak's energy.
    pre_inflation : Quantity, optional [-]
        Pre-inflation alpha, the radius added by inner pressure over that without.
    bending : Quantity, optional [G_s a^2]
        Bending modulus B.
    membrane_thickness : Quantity, optional [m]
        Thickness t, which determines B, in place of B.
    hardening : Quantity, optional [-]
        C of Skalak's law, in place of K = 1 + 2 C.
    source : str
        File or argument in which it is stated, for error messages.

    Raises
    ------
    InputError
        On an unknown law, a value that cannot be read, or two statements of one number.

    Examples
    --------
    >>> from capsbayes.surrogate import MembraneSurrogate
    >>> model, prior = Membrane("Skalak", hardening=1.0).applied(MembraneSurrogate.open("square"), Prior())
    >>> model.name
    'square-membrane at strain_hardening = 1, area_dilation_modulus = 3'
    >>> list(model.coordinates), dict(prior.coordinates)
    (['pre_inflation', 'bending'], {})
    """

    law: str = UNKNOWN
    area_dilation_modulus: Given | None = None
    strain_hardening: Given | None = None
    pre_inflation: Given | None = None
    bending: Given | None = None
    membrane_thickness: Given | None = None
    hardening: Given | None = None
    source: str = "membrane"

    def __post_init__(self) -> None:
        known = {law.lower(): law for law in LAWS}
        if not isinstance(self.law, str) or self.law.lower() not in known:
            raise InputError(self.source, "law", f"one of {', '.join(LAWS)}", repr(self.law))
        settle(self, law=known[self.law.lower()], **{name: self._read(name) for name in KEYS})
        for name in LAWS[self.law]:
            if getattr(self, name) is not None:
                raise InputError(self.source, name, f"nothing, as {self.law} states it", str(getattr(self, name)))
        if self.hardening is not None and (self.law != "Skalak" or self.area_dilation_modulus is not None):
            expected = "nothing but with the law Skalak, whose area_dilation_modulus K is 1 + 2 C then"
            raise InputError(self.source, "hardening", expected, str(self.hardening))
        if self.bending is not None and self.membrane_thickness is not None:
            raise InputError(self.source, f"bending, {THICKNESS}", "one of the two, as B = (t/a)^2 / 3", "both")

    @classmethod
    def read(cls, path: str | Path) -> Membrane | None:
        """Read the table ``[membrane]`` of a measurement's file, whose keys are the parameters; None without one.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        if "membrane" not in file.content:
            return None
        return cls(**file.table("membrane", optional=("law", *KEYS)), source=f"{path}: membrane")

    def with_texts(self, texts: Mapping[str, str], *, where: str) -> Membrane:
        """Return a copy in which parameters are replaced, given by name in text form."""
        return replace(self, **dict(texts), source=where)

    def applied(self, model: ForwardModel, prior: Prior) -> tuple[ForwardModel, Prior]:
        """Fix what is known in a model, and add what is uncertain to a prior.

        Parameters
        ----------
        model : ForwardModel
            With these parameters as coordinates, as `capsbayes.surrogate.MembraneSurrogate`.
        prior : Prior

        Raises
        ------
        InputError
            If the model has no such coordinate, a known value lies beyond its range, or the prior states one of them
            already.
        """
        stated = self._stated()
        fixed = {name: one.value for name, one in stated.items() if one.known and name != THICKNESS}
        for name, value in fixed.items():
            ends = model.coordinates.get(name)
            if ends is None or not ends.low <= value <= ends.high:
                lacking = "nothing, as the model does not have it"
                expected = lacking if ends is None else f"{ends.low:g} to {ends.high:g}"
                raise InputError(self.source, name, expected, f"{value:g}")
        for name in stated:
            if name in prior.coordinates:
                raise InputError(self.source, name, "one statement of it", f"{stated[name]}, and a prior")
        uncertain = {name: one for name, one in stated.items() if name not in fixed}
        believed = replace(prior, coordinates={**prior.coordinates, **uncertain})
        return (model.fixed(**fixed) if fixed else model), believed

    def _read(self, name: str) -> Quantity | None:
        given = getattr(self, name)
        if given is None or given == UNKNOWN:
            return None
        try:
            return Quantity.of(given, name, where=self.source, signed=name != THICKNESS)
        except InputError as error:
            example = "0.6 +/- 0.2 um" if name == THICKNESS else "1.5 +/- 0.3"
            expected = f'a number, a text as "{example}", or "{UNKNOWN}"'
            raise InputError(self.source, name, expected, error.got, error.advice) from None

    def _stated(self) -> dict[str, Quantity]:
        """Return what is known or uncertain, by the names of coordinates and that of the thickness."""
        found = {name: Quantity(value) for name, value in LAWS[self.law].items()}
        for name in KEYS:
            if name != "hardening" and getattr(self, name) is not None:
                found[name] = getattr(self, name)
        if self.hardening is not None:
            found["area_dilation_modulus"] = self._of_hardening(self.hardening)
        return found

    def _of_hardening(self, hardening: Quantity) -> Quantity:
        """Return K = 1 + 2 C."""
        if hardening.shape == "uniform":
            return Quantity.uniform(1.0 + 2.0 * hardening.low, 1.0 + 2.0 * hardening.high)
        if hardening.shape != "normal":
            expected = 'a number, a range as "0.5 .. 1.5" or a value with its error as "1.0 +/- 0.3"'
            raise InputError(self.source, "hardening", expected, str(hardening))
        return Quantity(1.0 + 2.0 * hardening.value, 2.0 * hardening.error, low=1.0 + 2.0 * hardening.low)


KEYS = tuple(field.name for field in fields(Membrane) if field.name not in ("law", "source"))
"""Names of the numbers of a membrane."""


def refuse_membrane(path: str | Path, where: str) -> None:
    """Refuse a measurement's file with a table ``[membrane]`` where the membrane is that of a database."""
    if "membrane" in InputFile.read(path).content:
        advice = "remove it, or use capsbayes identify"
        raise InputError(str(path), "membrane", f"no such table in a capsule of {where}", "one", advice)
