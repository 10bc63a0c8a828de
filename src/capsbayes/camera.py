"""Geometry of a camera: how its pictures differ from a drawing to one scale, as a calibration tells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.input_file import checked_table
from capsbayes.quantity import Given, Quantity

_STEPS = 30  # of the inversion of a distortion, each of which divides the error by ten at least
_LARGEST = 0.1  # deviation with its standard error, beyond which expansions to first order are too rough


class _Stated(NamedTuple):
    example: str
    ideal: float


_NUMBERS = {
    "pixel_aspect": _Stated("1.020 +/- 0.005", 1.0),
    "distortion": _Stated("-0.010 +/- 0.002", 0.0),
    "taper": _Stated("0.000 +/- 0.002", 0.0),
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
        for name in _NUMBERS:
            object.__setattr__(self, name, _number(getattr(self, name), "camera", name))

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
        return {name: it for name, it in known.items() if (it.mean, it.sd) != (_NUMBERS[name].ideal, 0.0)}

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
        raise InputError(where, key, f'a text like "{_NUMBERS[name].example}"', repr(value))
    return _number(value, where, key)


def _number(given: Given, where: str, key: str) -> Quantity:
    """Return a number of the camera; refuse one that is far from its ideal value."""
    example, ideal = _NUMBERS[key.rpartition(".")[2]]
    if isinstance(given, str):
        given = Quantity.read(given, where=where, key=key, units=("",), example=example, signed=True)
    made = Quantity.of(given, where=where, key=key, units=("",), signed=True)
    if made.shape == "normal":
        made = replace(made, low=-math.inf)
    if not abs(made.mean - ideal) + made.sd <= _LARGEST:
        expected = f'a number within {_LARGEST:g} of {ideal:g} with its error, as "{example}"'
        raise InputError(where, key, expected, str(made))
    return made


def _straightened(points: Floats, walls: float, aspect: float, distortion: float, taper: float) -> Floats:
    seen = np.asarray(points) / [aspect, 1.0]
    found = seen
    for _ in range(_STEPS if distortion else 0):
        square = np.sum(found**2, axis=-1, keepdims=True)
        found = seen * (1.0 + distortion * walls) / (1.0 + distortion * square)
    return np.asarray(found / (1.0 + taper * found[..., :1]))
