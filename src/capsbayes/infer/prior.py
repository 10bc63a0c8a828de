"""What is believed before the capsule is seen, stated on physical quantities.

G_s is log-uniform and a uniform by default, each over a range the user can
change; the mean velocity U of the flow is log-uniform without limits. They
are independent of each other, of the inputs (viscosity, half width) and of a
further coordinate of the model, which has any distribution and leaves the
following as it is.

The posterior is worked out in (log Ca, a/l, v_o), where the model and the
measured velocity live. At given viscosity mu and half width l

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

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import InputError
from capsbayes.input_file import InputFile
from capsbayes.parameters import COORDINATES
from capsbayes.quantity import Quantity

__all__ = ["Prior", "Range", "coordinate_prior", "log_jacobian"]

Floats = NDArray[np.float64]

_SHAPES = ("log-uniform", "uniform")
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_TEXT = re.compile(rf"{_NUMBER}\s*(\.\.|\+/-|±)\s*{_NUMBER}")
_UNITS = {"surface_shear_modulus": ("N/m", "10 mN/m"), "capsule_radius": ("m", "25 um")}


@dataclass(frozen=True)
class Range:
    """Uniform or log-uniform distribution between two positive limits.

    Parameters
    ----------
    shape : str
        ``"uniform"`` or ``"log-uniform"``.
    low, high : float
        Limits, in SI.

    Examples
    --------
    >>> round(float(Range("log-uniform", 1.0, 100.0).log_density_of_log(0.0)), 4)
    -1.5272
    """

    shape: str
    low: float
    high: float

    def __post_init__(self) -> None:
        if self.shape not in _SHAPES:
            raise InputError("prior", "distribution", " or ".join(_SHAPES), repr(self.shape))
        if not (np.isfinite(self.high) and 0.0 < self.low < self.high):
            raise InputError("prior", "low, high", "0 < low < high", f"{self.low:g}, {self.high:g}")

    @property
    def power(self) -> int:
        """The k of a density of log x proportional to x^k."""
        return 1 if self.shape == "uniform" else 0

    def log_density_of_log(self, logs: ArrayLike) -> Floats:
        """Log density of log x at given log x, normalised, -inf outside the range."""
        logs = np.asarray(logs, dtype=float)
        scale = self.high - self.low if self.power else np.log(self.high / self.low)
        within = (logs >= np.log(self.low)) & (logs <= np.log(self.high))
        return np.where(within, self.power * logs - np.log(scale), -np.inf)


@dataclass(frozen=True)
class Prior:
    """Independent priors of the shear modulus and of the radius.

    Parameters
    ----------
    surface_shear_modulus : Range [N/m]
        Default: log-uniform from 0.1 mN/m to 10 N/m, two decades about all microcapsules known.
    capsule_radius : Range [m]
        Default: uniform from 1 um to 1 mm; the domain of the model is narrower.
    coordinates : mapping of str to frozen distribution of scipy.stats
        Of the further coordinate of the model, as ``{"pre_inflation": scipy.stats.uniform(0.0, 0.1)}``. Default:
        uniform over the range of the model.
    """

    surface_shear_modulus: Range = Range("log-uniform", 1e-4, 10.0)
    capsule_radius: Range = Range("uniform", 1e-6, 1e-3)
    coordinates: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, path: str | Path) -> Prior:
        """Read the table ``[prior]`` of a measurement's file; what it does not state keeps its default.

        Each key holds ``{ distribution = "log-uniform", low = "1 mN/m", high = "1 N/m" }``, but that of a further
        coordinate of the model a text, see `coordinate_prior`.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        stated, where = file.table("prior", optional=(*_UNITS, *COORDINATES)), str(path)
        ranges: dict[str, Any] = {key: _range(where, key, value) for key, value in stated.items() if key in _UNITS}
        texts = {key: value for key, value in stated.items() if key in COORDINATES}
        return cls(**ranges).with_coordinates(texts, where=f"{where}: prior")

    def with_coordinates(self, texts: Mapping[str, object], *, where: str = "prior") -> Prior:
        """The same with priors of further coordinates of the model in text form, see `coordinate_prior`."""
        read = {name: coordinate_prior(text, where=where, key=name) for name, text in texts.items()}
        return replace(self, coordinates={**self.coordinates, **read})

    def log_density(self, theta: Mapping[str, Floats], velocity_ratio: Floats) -> Floats:
        """Log prior density in (log Ca, a/l, v_o) at given viscosity and half width.

        Parameters
        ----------
        theta : mapping
            ``capillary_number``, ``size_ratio``, ``viscosity``, ``half_width``, ``capsule_velocity``: (n,) arrays, SI.
        velocity_ratio : (n,) array
            v_o/U of the model there.

        Returns
        -------
        (n,) array
        """
        log_velocity = np.log(theta["capsule_velocity"] / velocity_ratio)
        log_modulus = np.log(theta["viscosity"]) + log_velocity - np.log(theta["capillary_number"])
        log_radius = np.log(theta["size_ratio"] * theta["half_width"])
        return (
            self.surface_shear_modulus.log_density_of_log(log_modulus)
            + self.capsule_radius.log_density_of_log(log_radius)
            - log_radius  # from log a to a
            + log_jacobian(half_width=theta["half_width"], capsule_velocity=theta["capsule_velocity"])
        )

    def described(self) -> dict[str, dict[str, Any]]:
        """Ranges of G_s and a in SI, for reports and files."""
        return {
            key: {"distribution": one.shape, "low": one.low, "high": one.high, "unit": unit}
            for key, (unit, _) in _UNITS.items()
            for one in [getattr(self, key)]
        }


def coordinate_prior(text: object, *, where: str, key: str) -> Any:
    """Distribution of a coordinate from its text form.

    Parameters
    ----------
    text : str
        ``"0 .. 0.1"``, uniform between two limits, or ``"0.03 +/- 0.01"``, normal.
    where, key : str
        What it is the prior of, for the message of an error.

    Returns
    -------
    frozen distribution of scipy.stats

    Examples
    --------
    >>> coordinate_prior("0..0.1", where="prior", key="pre_inflation").ppf(0.5).item()
    0.05
    """
    from scipy.stats import norm, uniform  # half a second to import

    found = _TEXT.fullmatch(str(text).strip())
    numbers = [float(found[1]), float(found[3])] if found else [np.nan, np.nan]
    if found and found[2] == ".." and numbers[0] < numbers[1]:
        return uniform(numbers[0], numbers[1] - numbers[0])
    if found and found[2] != ".." and numbers[1] > 0.0:
        return norm(*numbers)
    raise InputError(where, key, 'a range as "0 .. 0.1" or a value with its error as "0.03 +/- 0.01"', repr(text))


def log_jacobian(*, half_width: ArrayLike, capsule_velocity: ArrayLike) -> Floats:
    """Log of |d(log G_s, a, log U) / d(log Ca, a/l, v_o)| = log(l / v_o); see the module's text."""
    return np.log(np.asarray(half_width) / np.asarray(capsule_velocity))


def _range(where: str, key: str, stated: object) -> Range:
    unit, example = _UNITS[key]
    wanted = f'{{ distribution = "log-uniform", low = "{example}", high = "{example}" }}'
    if not isinstance(stated, Mapping) or set(stated) != {"distribution", "low", "high"}:
        raise InputError(where, f"prior.{key}", wanted, repr(stated))
    if stated["distribution"] not in _SHAPES:
        raise InputError(where, f"prior.{key}.distribution", " or ".join(_SHAPES), repr(stated["distribution"]))
    limits = [
        Quantity.read(stated[end], where=where, key=f"prior.{key}.{end}", units=(unit,), example=example).value
        for end in ("low", "high")
    ]
    if not limits[0] < limits[1]:
        raise InputError(where, f"prior.{key}", "low < high", f"{stated['low']!r}, {stated['high']!r}")
    return Range(stated["distribution"], limits[0], limits[1])
