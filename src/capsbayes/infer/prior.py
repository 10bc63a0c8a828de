"""Prior distributions, stated on physical quantities, and the further coordinates of a model with their priors.

G_s is log-uniform and a uniform by default, each over a range; the user can give
any distribution. The mean velocity U of the flow is log-uniform without limits. They
are independent of each other, of the inputs (viscosity, half width) and of the
further coordinates of the model, which have any distribution and do not
change what follows.

The posterior is computed in (log Ca, a/l, v_o), the variables of the model and
of the measured velocity. At given viscosity mu and half width l

    log G_s = log mu + log U - log Ca,    a = l (a/l),    log U = log v_o - log r(Ca, a/l)

with r = v_o/U of the model, and the matrix of derivatives of (log G_s, a, log U)
by (log Ca, a/l, v_o) is

    [ -1 - r_1   -r_2   1/v_o ]
    [    0         l      0   ]       r_1 = d log r / d log Ca,  r_2 = d log r / d(a/l)
    [   -r_1     -r_2   1/v_o ]

Its determinant is -l/v_o: the derivatives of r cancel. So the prior density in
(log Ca, a/l, v_o) is p(log G_s) p(a) l / v_o, and its support is the domain of
the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.files.input_file import InputFile
from capsbayes.model import CoordinateRange, ForwardModel
from capsbayes.parameters import COORDINATES, PARAMETERS, STATED
from capsbayes.quantity import Given, Quantity

LEAST_COVERED = 0.8
"""Of the mass of the prior of a coordinate, by the range of the model."""

NARROWEST = 1e-3
"""Standard deviation of a prior of G_s or a over its mean, below which no engine resolves it."""

_RANGES = {"log-uniform": Quantity.log_uniform, "uniform": Quantity.uniform}
_LIMITED = ("surface_shear_modulus", "capsule_radius")
THICKNESS = "membrane_thickness"
"""Name of the prior that takes the place of that of the bending modulus."""
_MODULUS, _RADIUS = Quantity.log_uniform(1e-4, 10.0, "N/m"), Quantity.uniform(1e-6, 1e-3, "m")


@dataclass(frozen=True)
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

    Raises
    ------
    InputError
        If G_s or a is a known number or nearly so, or a limit is not positive.

    Examples
    --------
    >>> Prior(surface_shear_modulus="log-uniform 1 .. 1000 mN/m").surface_shear_modulus.high
    1.0
    """

    surface_shear_modulus: Given = _MODULUS
    capsule_radius: Given = _RADIUS
    coordinates: Mapping[str, Given] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in _LIMITED:
            stated = Quantity.of(getattr(self, name), name, where="prior")
            if stated.known or (stated.is_range and stated.low <= 0.0):
                expected = 'a distribution, as "low .. high" with 0 < low < high, or "mean +/- error"'
                raise InputError("prior", name, expected, str(stated))
            if not stated.is_range and stated.sd < NARROWEST * stated.mean:
                raise InputError("prior", name, f"a standard error of at least {NARROWEST:.1%}", str(stated))
            object.__setattr__(self, name, stated)
        read = {name: _coordinate(quantity, "prior", name) for name, quantity in self.coordinates.items()}
        if THICKNESS in read and "bending" in read:
            raise InputError("prior", f"bending, {THICKNESS}", "one of the two, as B = (t/a)^2 / 3", "both")
        object.__setattr__(self, "coordinates", read)

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
        stated, where = file.table("prior", optional=(*_LIMITED, *COORDINATES)), str(path)
        ranges: dict[str, Any] = {
            key: _distribution(where, f"prior.{key}", value) for key, value in stated.items() if key in _LIMITED
        }
        texts = {key: value for key, value in stated.items() if key in COORDINATES}
        return replace(default or cls(), **ranges).with_texts(texts, where=f"{where}: prior")

    def with_texts(self, texts: Mapping[str, object], *, where: str = "prior") -> Prior:
        """Return a copy with other priors, in text form: of G_s and a, and of coordinates, see `coordinate_prior`."""
        own = {name: _distribution(where, name, texts[name]) for name in _LIMITED if name in texts}
        read = {name: coordinate_prior(texts[name], where=where, key=name) for name in texts if name not in own}
        return replace(self, **own, coordinates={**self.coordinates, **read})

    def described(self) -> dict[str, dict[str, Any]]:
        """Return the priors of G_s and a in SI, for reports and files."""
        found: dict[str, dict[str, Any]] = {}
        for name, known in zip(_LIMITED, self.both, strict=True):
            found[name] = {"distribution": known.shape, "low": known.low, "high": known.high, "unit": known.unit}
            if not known.is_range:
                found[name] |= {"mean": known.mean, "sd": known.sd, "record": known.as_record()}
        return found

    @classmethod
    def of_record(cls, described: Mapping[str, Mapping[str, Any]], coordinates: Mapping[str, Any]) -> Prior:
        """Return the prior that `described` gave, with records of the coordinates' quantities."""
        stated = [described[name] for name in _LIMITED]
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
    """Return the distribution of a coordinate from its text form.

    Parameters
    ----------
    text : str
        ``"0 .. 0.1"``, uniform between two limits, or ``"0.03 +/- 0.01"``, normal.
    where, key : str
        File and coordinate, for the message of an error.

    Raises
    ------
    InputError
        If the text is neither.

    Examples
    --------
    >>> coordinate_prior("0..0.1", where="prior", key="pre_inflation").ppf(0.5).item()
    0.05
    """
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


def _distribution(where: str, key: str, stated: object) -> Quantity:
    """Return the prior of G_s or a from a text, or from a table of a file that states a range."""
    name = key.rpartition(".")[2]
    if isinstance(stated, str):
        read = Quantity.of_text(stated, name, where=where, key=key)
        if read.known:
            raise InputError(where, key, 'a distribution, as "low .. high" or "mean +/- error"', repr(stated))
        return read
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
    """A coordinate and its prior, cut to the range of the model.

    Parameters
    ----------
    name : str
        As in `capsbayes.parameters`.
    distribution : Quantity
        Before the cut.
    low, high : float
        Range of the model.
    by_thickness : bool
        True if the distribution is that of a thickness [m], which tells the coordinate only together with the radius:
        `values` are thicknesses then, and not cut.

    Examples
    --------
    >>> alpha = Coordinate("pre_inflation", Quantity.uniform(0.0, 0.1), 0.0, 0.1)
    >>> alpha.values([0.25, 0.5]).round(6).tolist(), alpha.log_density(0.2).item()
    ([0.025, 0.05], -inf)
    """

    name: str
    distribution: Quantity
    low: float
    high: float
    by_thickness: bool = False

    @classmethod
    def all_of(cls, model: ForwardModel, prior: Prior) -> tuple[Coordinate, ...]:
        """Return the coordinates of a model in their order; a prior that is not stated is that of `CoordinateRange`.

        Raises
        ------
        InputError
            If the prior is of a name that is no coordinate of the model or reaches far beyond the range of the model.
        """
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
    """Refuse a prior of a name that is no coordinate of the model, naming those that are.

    Raises
    ------
    InputError
    """
    names = tuple(model.coordinates)
    for other in prior.coordinates:
        if ("bending" if other == THICKNESS else other) not in names:
            known = f"a coordinate of {model.name}" + (f" ({', '.join(names)})" if names else "")
            raise InputError("prior", other, known, f"a model of ({', '.join(('Ca', 'a/l', *names))})")
