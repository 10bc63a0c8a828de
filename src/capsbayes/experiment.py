"""Channel and liquid of an experiment; the only place where SI becomes Ca and a/l.

A number is known; a frozen distribution of `scipy.stats` is uncertain.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.errors import InputError
from capsbayes.input_file import InputFile
from capsbayes.quantity import Quantity, quantity

__all__ = [
    "Experiment",
    "capillary_number",
    "capsule_radius",
    "centre_and_error",
    "check_positive",
    "mean_velocity",
    "positive_normal",
    "size_ratio",
    "surface_shear_modulus",
]

Floats = NDArray[np.float64]
Uncertain = Any  # float, or a frozen distribution of scipy.stats, which has no public type

SECTIONS = ("square", "circular")
_NEGATIVE_SHARE = 1e-6  # of a distribution's mass that may lie below zero before it is refused


@dataclass(frozen=True, eq=False)
class Experiment:
    """What is known of the channel and of the suspending liquid.

    Parameters
    ----------
    section : str
        Cross-section of the channel, ``"square"`` or ``"circular"``.
    half_width : float or frozen distribution [m]
        Half the side of the square, or the radius of the circle, l.
    viscosity : float or frozen distribution [Pa s]
        Viscosity of the suspending liquid, mu.
    frame_rate : Quantity, optional [1/s]
        At which films were taken, with its standard error.
    source : str
        File the experiment was read from, empty if none.
    sha256 : str
        Fingerprint of that file.

    Raises
    ------
    InputError
        On an unknown section, or on a value that is not positive.

    Examples
    --------
    >>> experiment = Experiment(section="square", half_width=25e-6, viscosity=positive_normal(0.85, 0.02))
    >>> experiment.half_width, round(float(experiment.viscosity.std()), 3)
    (2.5e-05, 0.02)
    """

    section: str
    half_width: Uncertain
    viscosity: Uncertain
    source: str = ""
    sha256: str = ""
    frame_rate: Quantity | None = None

    def __post_init__(self) -> None:
        where = self.source or "experiment"
        if self.section not in SECTIONS:
            raise InputError(where, "section", " or ".join(f'"{name}"' for name in SECTIONS), repr(self.section))
        for key in ("half_width", "viscosity"):
            check_positive(getattr(self, key), where, key)

    @classmethod
    def read(cls, path: str | Path) -> Experiment:
        """Read an experiment from TOML with units.

        Parameters
        ----------
        path : path
            File with the keys ``section``, ``half_width`` and ``viscosity``;
            optionally ``frame_rate`` as "2000 Hz"; an error after ``+/-`` makes a value uncertain (a normal
            distribution cut at zero).

        Returns
        -------
        Experiment

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        table = file.table(required=("section", "half_width", "viscosity"), optional=("frame_rate",))
        where = str(path)
        width = quantity(table["half_width"], where=where, key="half_width", units=("m",), example="25.0 +/- 0.2 um")
        viscosity = quantity(
            table["viscosity"], where=where, key="viscosity", units=("Pa s",), example="0.85 +/- 0.02 Pa s"
        )
        rate = None
        if "frame_rate" in table:
            rate = quantity(table["frame_rate"], where=where, key="frame_rate", units=("1/s",), example="2000 Hz")
        widths, viscosities = _uncertain(width), _uncertain(viscosity)
        return cls(table["section"], widths, viscosities, source=where, sha256=file.sha256, frame_rate=rate)

    def write(self, path: str | Path) -> None:
        """Write a file that `read` reads.

        Parameters
        ----------
        path : path

        Raises
        ------
        InputError
            If a value is uncertain in another way than ``mean +/- error``.
        """
        lines = [
            f"section = {json.dumps(self.section)}",
            f'half_width = "{_text(self.half_width, "half_width")} m"',
            f'viscosity = "{_text(self.viscosity, "viscosity")} Pa s"',
        ]
        if self.frame_rate is not None:
            error = f" +/- {self.frame_rate.error!r}" if self.frame_rate.error else ""
            lines.append(f'frame_rate = "{self.frame_rate.value!r}{error} Hz"')
        Path(path).write_text("\n".join(lines) + "\n")


def positive_normal(mean: float, error: float) -> Uncertain:
    """Return a normal distribution cut at zero: what ``mean +/- error`` stands for.

    Parameters
    ----------
    mean, error : float
        Centre and standard deviation of the uncut normal, both positive.

    Returns
    -------
    frozen distribution
    """
    from scipy.stats import truncnorm  # half a second to import

    return truncnorm(-mean / error, np.inf, loc=mean, scale=error)


def centre_and_error(value: Uncertain) -> tuple[float, float]:
    """Mean and standard deviation of a number, which has none, or of a distribution.

    Examples
    --------
    >>> centre_and_error(25e-6)
    (2.5e-05, 0.0)
    """
    return (float(value.mean()), float(value.std())) if hasattr(value, "std") else (float(value), 0.0)


def capillary_number(*, viscosity: ArrayLike, mean_velocity: ArrayLike, surface_shear_modulus: ArrayLike) -> Floats:
    """Capillary number Ca = mu U / G_s, equation 1 of the paper.

    Examples
    --------
    >>> float(capillary_number(viscosity=1.0, mean_velocity=4e-3, surface_shear_modulus=0.04))
    0.1
    """
    return np.asarray(viscosity) * np.asarray(mean_velocity) / np.asarray(surface_shear_modulus)


def surface_shear_modulus(*, viscosity: ArrayLike, mean_velocity: ArrayLike, capillary_number: ArrayLike) -> Floats:
    """Shear modulus of the membrane G_s = mu U / Ca [N/m]."""
    return np.asarray(viscosity) * np.asarray(mean_velocity) / np.asarray(capillary_number)


def mean_velocity(*, capsule_velocity: ArrayLike, velocity_ratio: ArrayLike) -> Floats:
    """Mean velocity of the undisturbed flow U = v_o / (v_o/U) [m/s]."""
    return np.asarray(capsule_velocity) / np.asarray(velocity_ratio)


def size_ratio(*, capsule_radius: ArrayLike, half_width: ArrayLike) -> Floats:
    """Radius of the capsule over the half width of the channel, a/l [-]."""
    return np.asarray(capsule_radius) / np.asarray(half_width)


def capsule_radius(*, size_ratio: ArrayLike, half_width: ArrayLike) -> Floats:
    """Radius of the capsule a = (a/l) l [m]."""
    return np.asarray(size_ratio) * np.asarray(half_width)


def _uncertain(read: Quantity) -> Uncertain:
    return positive_normal(read.value, read.error) if read.error > 0.0 else read.value


def _text(value: Uncertain, key: str) -> str:
    """A number, or the mean and the error of a normal distribution cut at zero."""
    if not hasattr(value, "cdf"):
        return repr(float(value))
    if value.dist.name != "truncnorm" or set(value.kwds) != {"loc", "scale"}:
        expected = 'a number or a distribution "mean +/- error", made by positive_normal'
        raise InputError("experiment", key, expected, f"one of the kind {value.dist.name}")
    return f"{float(value.kwds['loc'])!r} +/- {float(value.kwds['scale'])!r}"


def check_positive(value: Uncertain, where: str, key: str) -> None:
    """Refuse a number or a distribution that is not positive and finite, naming its file or argument and its key."""
    if hasattr(value, "cdf"):
        if not np.isfinite(value.std()):
            raise InputError(where, key, "a distribution of finite variance", "an infinite or undefined one")
        below = float(value.cdf(0.0))
        if below > _NEGATIVE_SHARE:
            raise InputError(where, key, "a positive distribution", f"{below:.2g} of it below zero", "cut it at zero")
    elif not isinstance(value, (int, float, np.floating)) or not (np.isfinite(value) and value > 0.0):
        raise InputError(where, key, "a positive finite number or a frozen scipy.stats distribution", repr(value))
