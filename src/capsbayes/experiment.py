"""Channel and liquid of an experiment; the only place where SI becomes Ca and a/l."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.camera import Camera
from capsbayes.errors import InputError
from capsbayes.files.input_file import InputFile, quantity, unread
from capsbayes.files.output_file import write_file
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Given, Quantity
from capsbayes.readable import Readable

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
        for key in ("half_width", *given, *_OPTIONAL):
            if key not in _OPTIONAL or getattr(self, key) is not None:
                object.__setattr__(self, key, Quantity.of(getattr(self, key), key, where=where))

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

        Returns
        -------
        Experiment

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
        found = {
            "cross_section": self.cross_section,
            **{key: value.shown(key) for key, value in stated.items() if value is not None},
        }
        more = {"camera": self.camera and self.camera.described(), "source": self.source}
        return found | {name: text for name, text in more.items() if text}

    def write(self, path: str | Path) -> None:
        """Write a file that `read` reads.

        Parameters
        ----------
        path : path

        Raises
        ------
        InputError
            If a value has a distribution without a text form.
        """
        lines = [
            f"cross_section = {json.dumps(self.cross_section)}",
            f'half_width = "{_text(self.half_width, "half_width")}"',
        ]
        for key in (*_FLUID, *_OPTIONAL):
            value = getattr(self, key)
            if value not in (None, WATER):
                lines.append(f'{key} = "{_text(value, key)}"')
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
