"""The experiment: channel, liquid and camera."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import InputFile, checked_table, quantity, unread
from capsbayes.files.output_file import write_file
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Given, Quantity, settle
from capsbayes.readable import Readable

# Geometry of a camera: how its pictures differ from a drawing to one scale, as a calibration tells

_STEPS = 30  # of the inversion of a distortion, each of which divides the error by ten at least
_LARGEST = 0.1  # deviation with its standard error, beyond which expansions to first order are too rough


_NUMBERS = {  # of a camera: an example, and the ideal value
    "pixel_aspect": ("1.020 +/- 0.005", 1.0),
    "distortion": ("-0.010 +/- 0.002", 0.0),
    "taper": ("0.000 +/- 0.002", 0.0),
}


@dataclass(frozen=True)
class Camera:
    """Geometry of a camera and its lens, each number with its standard error.

    A point at a place (x, y) along and across the channel from the middle of the picture, over l, is seen at
    (h s x, s y) with

        s = (1 + k r^2) / ((1 + k w) (1 - t x)),    r^2 = x^2 + y^2 after the division by 1 - t x,

    where l is read across the channel at walls whose mean square distance from the middle is w.

    Parameters
    ----------
    pixel_aspect : Quantity
        Height of a pixel over its width, h.
    distortion : Quantity
        Relative change of the magnification a half width away from the middle of the picture, k; negative for a barrel.
    taper : Quantity
        Relative change of the magnification along a half width to the right, t. It is tan(angle) l/D where the channel
        is tilted by an angle to the focal plane and its right end comes nearer to a lens at the distance D.

    Raises
    ------
    InputError
        If a number is none, or too large.

    Examples
    --------
    >>> Camera(pixel_aspect="1.02 +/- 0.005").straightened(np.array([1.02, 0.5]), walls=1.0)
    array([1. , 0.5])
    """

    pixel_aspect: Given = 1.0
    distortion: Given = 0.0
    taper: Given = 0.0

    def __post_init__(self) -> None:
        settle(self, **{name: _number(getattr(self, name), "camera", name) for name in _NUMBERS})

    @classmethod
    def read(cls, table: Any, where: str, key: str) -> Camera:
        """Read the table of a file, of texts like ``pixel_aspect = "1.020 +/- 0.005"``, which are ratios.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        return cls(**checked_table(table, where, key, optional=dict.fromkeys(_NUMBERS, _read)))

    @property
    def stated(self) -> Mapping[str, Quantity]:
        """What differs from a camera without faults, or is uncertain, by name."""
        known = {name: getattr(self, name) for name in _NUMBERS}
        return {name: it for name, it in known.items() if (it.mean, it.sd) != (_NUMBERS[name][1], 0.0)}

    def straightened(self, points: Floats, *, walls: float) -> Floats:
        """Return where points are that are seen at places.

        Parameters
        ----------
        points : (..., 2) array
            To the right along the channel and across it, from the middle of the picture on its axis, over l as it is
            read in the picture.
        walls : float
            Mean square distance from the middle of the walls where l is read, over l^2: 1 + (Z/l)^2 / 3 along a picture
            of the length 2 Z.

        Returns
        -------
        (..., 2) array
        """
        return _straightened(points, walls, *(getattr(self, name).mean for name in _NUMBERS))

    def errors_of(self, points: Floats, *, walls: float) -> Floats:
        """Return the change of `straightened` by a standard error of each number : (3, ..., 2) array."""
        means, sds = np.array([(getattr(self, name).mean, getattr(self, name).sd) for name in _NUMBERS]).T
        here = _straightened(points, walls, *means)
        return np.array([_straightened(points, walls, *row) - here for row in means + np.diag(sds)])

    def described(self) -> str:
        """Return what is stated in one line."""
        return ", ".join(f"{name} {value}" for name, value in self.stated.items())


def _read(value: object, where: str, key: str) -> Quantity:
    if not isinstance(value, str):  # a number has no error: zero would be taken for one that was measured
        name = key.rpartition(".")[2]
        raise InputError(where, key, f'a text like "{_NUMBERS[name][0]}"', repr(value))
    return _number(value, where, key)


def _number(given: Given, where: str, key: str) -> Quantity:
    """Return a number of the camera; refuse one that is far from its ideal value."""
    example, ideal = _NUMBERS[key.rpartition(".")[2]]
    made = Quantity.of(given, where=where, key=key, units=("",), example=example, signed=True)
    if made.shape == "normal":
        made = replace(made, low=-math.inf)
    if not abs(made.mean - ideal) + made.sd <= _LARGEST:
        expected = f'a number within {_LARGEST:g} of {ideal:g} with its error, as "{example}"'
        raise InputError(where, key, expected, str(made))
    return made


def _straightened(points: Floats, walls: float, aspect: float, distortion: float, taper: float) -> Floats:
    seen = np.asarray(points) / [aspect, 1.0]
    straight = seen
    for _ in range(_STEPS if distortion else 0):
        square = np.sum(straight**2, axis=-1, keepdims=True)
        straight = seen * (1.0 + distortion * walls) / (1.0 + distortion * square)
    return np.asarray(straight / (1.0 + taper * straight[..., :1]))


# Viscosity of a suspending liquid from what it was made of: with its error, and where it comes from

FORMULA_ERROR = 0.04
"""Relative standard error of the formula of `water_glycerol` itself."""

SOURCE = "Cheng 2008, https://doi.org/10.1021/ie071349z"

OIL_ERROR = 0.03
"""Relative standard error of the formula of `silicone_oil`, for oils of 100 mm^2/s and more."""

OIL_SOURCE = "Shin-Etsu, Silicone fluid KF-96, performance test results"

MEDIUM_ERROR = 0.12
"""Relative standard error of `methylcellulose`: half of the largest difference between two published formulas."""

MEDIUM_SOURCE = "Büyükurganci et al. 2023, https://doi.org/10.1039/D2SM01515C"

SHEAR_RATES = 5e3, 1.5e5
"""Shear rates [1/s] at which methylcellulose was measured to be a power-law liquid."""

MEDIA = {"0.49%": (2.30e-6, -0.0056), "0.59%": (5.70e-6, -0.0744), "0.83%": (16.52e-6, -0.1455)}
"""Mass of methylcellulose in buffered saline, with the constants a [Pa s^n] and beta of its power law."""

_HERE = "viscosity"
_FREEZING = 273.15  # K
_MEDIA_TEMPERATURES = 22.0, 37.0  # degrees C, in which the power law was fitted
_TEMPERATURES = 0.0, 100.0  # degrees C, in which the other formulas were
_OILS = 0.999e-4, 1.001  # m^2/s at 25 degrees C
_BEYOND = 2.0  # factor by which the shear rate may lie beyond those measured, with a wider error
_EXAMPLE = "23.0 +/- 0.5 degC"
_STEP_OF_SHARE = 1e-5  # of central differences


def water_glycerol(mass_fraction: Given, temperature: Given) -> Quantity:
    """Return the viscosity of a mixture of water and glycerol with its standard error.

    The errors of mass fraction and temperature are carried through the formula to first order, and added to its own
    error `FORMULA_ERROR`.

    Parameters
    ----------
    mass_fraction : Quantity [-]
        Mass of glycerol over that of the mixture, from 0 to 1.
    temperature : Quantity
        From 0 to 100 degrees Celsius, as ``"23.0 degC"`` or ``"296.15 K"``; in degrees Celsius without a unit.

    Returns
    -------
    Quantity [Pa s]

    Raises
    ------
    InputError
        If either is no number, or lies out of the range of the formula.

    References
    ----------
    Cheng 2008, Ind. Eng. Chem. Res. 47, 3285, https://doi.org/10.1021/ie071349z.

    Examples
    --------
    >>> viscosity = water_glycerol("0.98 +/- 0.002", "23.0 +/- 0.5 degC")
    >>> f"{viscosity.value:.2f} +/- {viscosity.error:.2f} {viscosity.unit}"
    '0.71 +/- 0.05 Pa s'
    """
    share = _within(mass_fraction, "mass_fraction", (0.0, 1.0), "0.98 +/- 0.002")
    degrees = _celsius(temperature, _TEMPERATURES)
    inside = min(max(share.value, _STEP_OF_SHARE), 1.0 - _STEP_OF_SHARE)
    by_share = _slope(lambda shares: cheng(shares, degrees.value), inside, _STEP_OF_SHARE)
    by_degrees = _slope(lambda temperatures: cheng(share.value, temperatures), degrees.value)
    relative = math.hypot(by_share * share.error, by_degrees * degrees.error, FORMULA_ERROR)
    mean = float(cheng(share.value, degrees.value))
    return Quantity(mean, relative * mean, "Pa s")


def silicone_oil(kinematic_viscosity: Given, density: Given, temperature: Given) -> Quantity:
    """Return the viscosity of a dimethyl silicone oil with its standard error.

    Parameters
    ----------
    kinematic_viscosity : Quantity [m^2/s]
        At 25 degrees C, as its bottle states it; from 100 to 1,000,000 mm^2/s.
    density : Quantity [kg/m^3]
        At 25 degrees C.
    temperature : Quantity
        As of `water_glycerol`, from 0 to 100 degrees Celsius.

    Returns
    -------
    Quantity [Pa s]

    Raises
    ------
    InputError
        If one is no number, or lies out of the range of the formula.

    References
    ----------
    Shin-Etsu, Silicone fluid KF-96, performance test results: log10 nu = log10 nu_25 + 763.1 / (273 + t) - 2.559, and
    a density that falls by 0.095 % a degree.

    Examples
    --------
    >>> viscosity = silicone_oil("1000 +/- 20 mm^2/s", "970 +/- 2 kg/m^3", "21.0 +/- 0.5 degC")
    >>> f"{viscosity.value:.2f} +/- {viscosity.error:.2f} {viscosity.unit}"
    '1.06 +/- 0.04 Pa s'
    """
    stated = _of_unit(kinematic_viscosity, "kinematic_viscosity", "m^2/s", "1000 +/- 20 mm^2/s")
    if not _OILS[0] < stated.value < _OILS[1]:
        raise InputError(_HERE, "kinematic_viscosity", "from 100 to 1,000,000 mm^2/s", str(stated))
    mass = _of_unit(density, "density", "kg/m^3", "970 +/- 2 kg/m^3")
    degrees = _celsius(temperature, _TEMPERATURES)

    def factor(temperature: ArrayLike) -> Floats:
        t = np.asarray(temperature, dtype=float)
        return np.asarray(10.0 ** (763.1 / (273.0 + t) - 2.559) * (1.0 - 0.95e-3 * (t - 25.0)))

    by_degrees = _slope(factor, degrees.value)
    errors = stated.error / stated.value, mass.error / mass.value, by_degrees * degrees.error, OIL_ERROR
    mean = float(stated.value * mass.value * factor(degrees.value))
    return Quantity(mean, math.hypot(*errors) * mean, "Pa s")


def methylcellulose(medium: str, temperature: Given, flow_rate: Given, half_width: Given) -> Quantity:
    """Return the viscosity of methylcellulose in saline at the shear rate of the wall of a square channel.

    At shear rates beyond `SHEAR_RATES` by up to a factor of two the error is wider by the change of the viscosity from
    the nearest of them.

    Parameters
    ----------
    medium : str
        Mass of methylcellulose, one of `MEDIA`.
    temperature : Quantity
        As of `water_glycerol`, from 22 to 37 degrees Celsius.
    flow_rate : Quantity [m^3/s]
        Of the liquid in the channel.
    half_width : Quantity [m]
        Of the channel.

    Returns
    -------
    Quantity [Pa s]

    Raises
    ------
    InputError
        If one is no number, or out of the range of the formula, or the shear rate is far beyond `SHEAR_RATES`.

    References
    ----------
    Büyükurganci et al. 2023, Soft Matter 19, 1739: mu = K rate^(n - 1), K = a exp(3379.7 K / T), n = 0.00223 T / K +
    beta. Herold 2017, arXiv:1704.00572, eq. 5.2: the rate at the wall, 8 Q / w^3 (0.6671 + 0.2121 / n).

    Examples
    --------
    >>> viscosity = methylcellulose("0.49%", "23.0 +/- 0.5 degC", "0.16 +/- 0.002 uL/s", "10.0 +/- 0.1 um")
    >>> f"{1e3 * viscosity.value:.2f} +/- {1e3 * viscosity.error:.2f} mPa s"
    '3.33 +/- 0.41 mPa s'
    """
    if medium not in MEDIA:
        raise InputError(_HERE, "medium", f"one of {', '.join(MEDIA)}", medium)
    degrees = _celsius(temperature, _MEDIA_TEMPERATURES)
    flow = _of_unit(flow_rate, "flow_rate", "m^3/s", "0.16 +/- 0.002 uL/s")
    width = _of_unit(half_width, "half_width", "m", "10.0 +/- 0.1 um")
    a, beta = MEDIA[medium]

    def law(temperature: ArrayLike) -> tuple[Floats, Floats, Floats]:
        kelvin = _FREEZING + np.asarray(temperature, dtype=float)
        index = 0.00223 * kelvin + beta
        rate = 8.0 * flow.value / (2.0 * width.value) ** 3 * (0.6671 + 0.2121 / index)
        return np.asarray(a * np.exp(3379.7 / kelvin) * rate ** (index - 1.0)), index, rate

    least, most = SHEAR_RATES
    mean, index, rate = (float(number) for number in law(degrees.value))
    beyond = max(least / rate, rate / most, 1.0)
    if beyond > _BEYOND:
        expected = f"a shear rate at the wall from {least / _BEYOND:g} to {most * _BEYOND:g} 1/s"
        advice = "measure the viscosity at this shear rate"
        raise InputError(_HERE, "flow_rate, half_width", expected, f"{rate:.3g} 1/s", advice)
    by_degrees = _slope(lambda temperatures: law(temperatures)[0], degrees.value)
    by_rate = index - 1.0
    of_rate = by_rate * flow.error / flow.value, 3.0 * by_rate * width.error / width.value
    errors = *of_rate, by_degrees * degrees.error, MEDIUM_ERROR, by_rate * math.log(beyond)
    return Quantity(mean, math.hypot(*errors) * mean, "Pa s")


def cheng(mass_fraction: ArrayLike, temperature: ArrayLike) -> Floats:
    """Return the viscosity of water with a mass fraction of glycerol at temperatures in degrees C [Pa s].

    >>> cheng(mass_fraction=[0.0, 1.0], temperature=20.0).round(4)
    array([1.0000e-03, 1.4138e+00])
    """
    # Cheng 2008, Ind. Eng. Chem. Res. 47, 3285, https://doi.org/10.1021/ie071349z
    share, degrees = np.asarray(mass_fraction, dtype=float), np.asarray(temperature, dtype=float)
    water = 1.790e-3 * np.exp((-1230.0 - degrees) * degrees / (36100.0 + 360.0 * degrees))
    glycerol = 12.100 * np.exp((-1233.0 + degrees) * degrees / (9900.0 + 70.0 * degrees))
    a = 0.705 - 0.0017 * degrees
    b = (4.9 + 0.036 * degrees) * a**2.5
    weight = 1.0 - share + a * b * share * (1.0 - share) / (a * share + b * (1.0 - share))
    return np.asarray(water**weight * glycerol ** (1.0 - weight))


def _slope(function: Callable[[Floats], Floats], place: float, step: float = 1e-3) -> float:
    """Return the derivative of the logarithm of a function by central differences."""
    below, above = function(place + np.array([-1, 1]) * step)
    return float(np.log(above / below) / (2.0 * step))


def _of_unit(given: Given, key: str, unit: str, example: str) -> Quantity:
    """Return a positive number with a unit, and its error."""
    made = Quantity.of(given, key, where=_HERE, units=(unit,), example=example)
    if not (made.shape == "normal" and made.value > 0.0):
        raise InputError(_HERE, key, f'a number with its error and unit, as "{example}"', str(made))
    return made


def _celsius(given: Given, limits: tuple[float, float]) -> Quantity:
    """Return a temperature in degrees Celsius within limits, with its error."""
    made = Quantity.of(given, "temperature", where=_HERE, units=("", "K"), example=_EXAMPLE, signed=True)
    if made.unit:
        made = replace(made.rescaled(round(made.value - _FREEZING, 9)), unit="")
    return _within(made, "temperature", limits, _EXAMPLE)


def _within(given: Given, key: str, limits: tuple[float, float], example: str) -> Quantity:
    """Return a number within limits, with its error."""
    made, (least, most) = Quantity.of(given, key, where=_HERE, units=("",), example=example, signed=True), limits
    if not (made.shape == "normal" and least <= made.value <= most):
        raise InputError(_HERE, key, f'a number from {least:g} to {most:g} with its error, as "{example}"', str(made))
    return made


# Channel and liquid of an experiment; the only place where SI becomes Ca and a/l

WATER = Quantity(998.0, unit="kg/m^3")
"""Density of a suspending liquid for which none is stated."""

AREAS = {"square": 4.0, "circular": math.pi}
"""Areas of the cross-sections over l^2."""

_FLUID = ("viscosity", "viscous_tension")  # one of them
_OPTIONAL = ("frame_rate", "exposure", "density", "membrane_thickness")


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Readable):
    """Channel and suspending liquid, as far as they are known.

    Parameters
    ----------
    cross_section : str
        Cross-section of the channel, ``"square"`` or ``"circular"``.
    half_width : Quantity [m]
        Half the side of the square, or the radius of the circle, l. This and the next two may be given as whatever
        `Quantity.of` reads: ``"25.0 +/- 0.2 um"``, a number in SI, a quantity of pint, a frozen distribution.
    viscosity : Quantity [Pa s]
        Viscosity of the suspending liquid, mu. Either this or `viscous_tension` is given.
    frame_rate : Quantity, optional [1/s]
        Pictures per second of films.
    density : Quantity [kg/m^3]
        Of the suspending liquid; by default that of water at 20 C. Only the Reynolds number is computed from it.
    membrane_thickness : Quantity, optional [m]
        Thickness t of the membrane. It gives the bending modulus in a model that has it as a coordinate, see `bending`.
    viscous_tension : Quantity, optional [N/m]
        The product mu U, with U the mean velocity of the undisturbed flow, where neither factor is known. Then
        G_s = mu U / Ca, and the velocity of a capsule is not used. `identify` accepts it for one capsule; functions
        that need the viscosity or a velocity raise an error.
    exposure : Quantity, optional [s]
        Exposure time of one picture, that of the shutter or of a flash. A capsule that moves by more than three
        pixels in it is refused.
    camera : Camera, optional
        Geometry of the camera with which the pictures were taken; by default it has no faults.
    source : str
        File the experiment was read from, empty if none.
    sha256 : str
        Fingerprint of that file.

    Raises
    ------
    InputError
        On an unknown cross-section, on a value that is not positive or not plausible, or unless one of viscosity and
        viscous tension is given.

    Examples
    --------
    >>> experiment = Experiment(cross_section="square", half_width=25e-6, viscosity="0.85 +/- 0.02 Pa s")
    >>> experiment.half_width.value, experiment.viscosity.error
    (2.5e-05, 0.02)
    >>> experiment
    <Experiment: cross_section square; half_width 25 µm; viscosity 0.85 +/- 0.02 Pa s>
    """

    cross_section: str
    half_width: Given
    viscosity: Given = None
    source: str = ""
    sha256: str = ""
    frame_rate: Given | None = None
    density: Given = WATER
    membrane_thickness: Given | None = None
    viscous_tension: Given | None = None
    exposure: Given | None = None
    camera: Camera | None = None

    def __post_init__(self) -> None:
        where = self.source or "experiment"
        if not isinstance(self.cross_section, str) or self.cross_section not in AREAS:
            expected = " or ".join(f'"{name}"' for name in AREAS)
            raise InputError(where, "cross_section", expected, repr(self.cross_section))
        given = [key for key in _FLUID if getattr(self, key) is not None]
        if len(given) != 1:
            expected = "one of the two: viscous_tension is mu U, for when mu and U are not known"
            raise InputError(where, ", ".join(_FLUID), expected, "both" if given else "neither")
        stated = [*given, *(key for key in _OPTIONAL if getattr(self, key) is not None)]
        settle(self, **{key: Quantity.of(getattr(self, key), key, where=where) for key in ("half_width", *stated)})

    @classmethod
    def read(cls, path: str | Path) -> Experiment:
        """Read an experiment from TOML with units.

        Parameters
        ----------
        path : path
            File with the keys ``cross_section`` (``section`` in older files), ``half_width`` and ``viscosity``, or
            ``viscous_tension`` in place of it, and optionally ``frame_rate``, ``exposure``, ``density`` and
            ``membrane_thickness``; all but the first are texts that `Quantity.read` reads. A table ``[camera]`` states
            the geometry of the camera as `Camera.read` reads it.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        file = InputFile.read(path)
        table = file.table(
            required={"cross_section": unread, "half_width": quantity("half_width")},
            optional={key: quantity(key) for key in (*_FLUID, *_OPTIONAL)} | {"camera": Camera.read},
            renamed={"section": "cross_section"},
        )
        return cls(**table, source=str(path), sha256=file.sha256)

    def reynolds_number(self, mean_velocity: ArrayLike) -> Floats:
        """Return rho U l / mu at a mean velocity of the undisturbed flow [m/s]; NaN where mu is not known."""
        if self.viscosity is None:
            return np.full(np.shape(mean_velocity), np.nan)
        return self.density.mean * _si(mean_velocity, "mean_velocity") * self.half_width.mean / self.viscosity.mean

    def described(self) -> dict[str, str]:
        """Return channel and liquid in display units."""
        stated = {key: getattr(self, key) for key in ("half_width", *_FLUID, *_OPTIONAL)}
        if self.density == WATER:
            del stated["density"]
        numbers = {key: value.shown(key) for key, value in stated.items() if value is not None}
        more = {"camera": self.camera and self.camera.described(), "source": self.source}
        return {"cross_section": self.cross_section} | numbers | {name: text for name, text in more.items() if text}

    def write(self, path: str | Path) -> None:
        """Write a file that `read` reads.

        Raises
        ------
        InputError
            If a value has a distribution without a text form.
        """
        lines = [f"cross_section = {json.dumps(self.cross_section)}"]
        stated = ((key, getattr(self, key)) for key in ("half_width", *_FLUID, *_OPTIONAL))
        lines += [f'{key} = "{_text(value, key)}"' for key, value in stated if value not in (None, WATER)]
        if self.camera is not None:
            lines += ["", "[camera]", *(f'{key} = "{_text(it, key)}"' for key, it in self.camera.stated.items())]
        write_file(path, "\n".join(lines) + "\n")


def capillary_number(*, viscosity: ArrayLike, mean_velocity: ArrayLike, surface_shear_modulus: ArrayLike) -> Floats:
    """Return the capillary number Ca = mu U / G_s, equation 1 of the paper.

    This and its inverses take numbers in SI, texts with units, and quantities of pint, which may be arrays.

    Examples
    --------
    >>> float(capillary_number(viscosity=1.0, mean_velocity=4e-3, surface_shear_modulus=0.04))
    0.1
    """
    return (
        _si(viscosity, "viscosity")
        * _si(mean_velocity, "mean_velocity")
        / _si(surface_shear_modulus, "surface_shear_modulus")
    )


def surface_shear_modulus(*, viscosity: ArrayLike, mean_velocity: ArrayLike, capillary_number: ArrayLike) -> Floats:
    """Return the shear modulus of the membrane G_s = mu U / Ca [N/m]."""
    return _si(viscosity, "viscosity") * _si(mean_velocity, "mean_velocity") / _si(capillary_number, "capillary_number")


def imposed_velocity(*, viscosity: ArrayLike, capillary_number: ArrayLike, surface_shear_modulus: ArrayLike) -> Floats:
    """Return the mean velocity of the flow that gives a capillary number, U = Ca G_s / mu [m/s]."""
    return (
        _si(capillary_number, "capillary_number")
        * _si(surface_shear_modulus, "surface_shear_modulus")
        / _si(viscosity, "viscosity")
    )


def mean_velocity(*, capsule_velocity: ArrayLike, velocity_ratio: ArrayLike) -> Floats:
    """Return the mean velocity of the undisturbed flow U = v_o / (v_o/U) [m/s]."""
    return _si(capsule_velocity, "capsule_velocity") / _si(velocity_ratio, "velocity_ratio")


def size_ratio(*, capsule_radius: ArrayLike, half_width: ArrayLike) -> Floats:
    """Return the radius of the capsule over the half width of the channel, a/l [-]."""
    return _si(capsule_radius, "capsule_radius") / _si(half_width, "half_width")


def capsule_radius(*, size_ratio: ArrayLike, half_width: ArrayLike) -> Floats:
    """Return the radius of the capsule a = (a/l) l [m]."""
    return _si(size_ratio, "size_ratio") * _si(half_width, "half_width")


def bending(*, membrane_thickness: ArrayLike, capsule_radius: ArrayLike) -> Floats:
    """Return the bending modulus over G_s a^2 of a shell of incompressible material, B = (t/a)^2 / 3 [-].

    Its bending stiffness is E t^3 / (12 (1 - nu^2)) with nu = 1/2 and E t = 3 G_s.

    Examples
    --------
    >>> float(bending(membrane_thickness=0.6e-6, capsule_radius=24e-6).round(7))
    0.0002083
    """
    return (_si(membrane_thickness, "membrane_thickness") / _si(capsule_radius, "capsule_radius")) ** 2 / 3.0


def membrane_thickness(*, bending: ArrayLike, capsule_radius: ArrayLike) -> Floats:
    """Return the thickness of the membrane t = a (3 B)^(1/2) [m], the inverse of `bending`."""
    return _si(capsule_radius, "capsule_radius") * np.sqrt(3.0 * _si(bending, "bending"))


def _si(given: Any, name: str) -> Floats:
    """Return numbers in SI, those of a text or a quantity of pint converted; numpy would drop the unit."""
    if isinstance(given, str):
        return np.asarray(Quantity.of(given, name).value)
    if hasattr(given, "dimensionality"):
        unit = PARAMETERS[name].si or "dimensionless"
        if not given.is_compatible_with(unit):
            raise InputError("experiment", name, f"a quantity in {unit}", str(given))
        return np.asarray(given.to(unit).magnitude)
    return np.asarray(given)


def _text(value: Quantity, key: str) -> str:
    """Return the text form; refuse a distribution that has none."""
    if value.family is not None:
        expected = 'a number, "mean +/- error" or "low .. high"'
        raise InputError("experiment", key, expected, f"a distribution of the kind {value.shape}")
    return str(value)
