"""The undisturbed flow of a channel section, and the points that stand for its walls.

Lengths are over the half width l, velocities over the mean velocity U, so the
walls of the square section are x = +-1 and y = +-1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Channel", "SquareChannel", "WallPoints", "section_named"]

Array = NDArray[np.float64]


class WallPoints(NamedTuple):
    """Points (p, 3) of one wedge 0 <= y <= x and the wall area (p,) each stands for."""

    points: Array
    areas: Array


class Channel(ABC):
    """A straight channel along z whose section has the symmetry of the square."""

    name: ClassVar[str]
    area: ClassVar[float]
    """Area of the section over l^2."""
    pressure_gradient: ClassVar[float]
    """-(dp/dz) l^2 / (mu U) of the undisturbed flow."""

    @abstractmethod
    def undisturbed(self, points: Array) -> tuple[Array, Array]:
        """Axial velocity (p,) of the undisturbed flow at `points` (p, 3), and its gradient along x, y, z (p, 3)."""

    @abstractmethod
    def wall_points(self, axial: Array, steps: Array, spacing: float, *, offset: float, end: float) -> WallPoints:
        """Points on the section's wall moved outwards by `offset`, with end caps at +-(`end` + `offset`).

        Parameters
        ----------
        axial, steps : (m,) arrays
            Axial positions of the rings of points, and the length each stands for.
        spacing : float
            Distance of points along the section's outline and on the caps.
        """


_ODD = np.arange(1, 160, 2)
_RATE = 0.5 * np.pi * _ODD
_SIGN = (-1.0) ** ((_ODD - 1) // 2)
_SERIES = 16 / np.pi**3 * _SIGN / _ODD**3


@dataclass(frozen=True)
class SquareChannel(Channel):
    """Square section of half width one."""

    name: ClassVar[str] = "square"
    area: ClassVar[float] = 4.0
    pressure_gradient: ClassVar[float] = float(1.0 / (1 / 3 - np.sum(64 * np.tanh(_RATE) / (np.pi * _ODD) ** 5)))

    def undisturbed(self, points: Array) -> tuple[Array, Array]:
        """Fourier series of the unidirectional flow; see :meth:`Channel.undisturbed`."""
        x, y = points[:, :1], points[:, 1:2]
        cosine, sine = np.cos(_RATE * x), np.sin(_RATE * x)
        # cosh(k y)/cosh(k) without overflow
        rise, fall = np.exp(_RATE * (np.abs(y) - 1)), np.exp(-_RATE * (np.abs(y) + 1))
        even = (rise + fall) / (1 + np.exp(-2 * _RATE))
        odd = np.sign(y) * (rise - fall) / (1 + np.exp(-2 * _RATE))
        scale = self.pressure_gradient
        value = 0.5 * scale * ((1 - x[:, 0] ** 2) - 2 * (_SERIES * cosine * even).sum(1))
        gradient = np.zeros_like(points)
        gradient[:, 0] = scale * (-x[:, 0] + (_SERIES * _RATE * sine * even).sum(1))
        gradient[:, 1] = -scale * (_SERIES * _RATE * cosine * odd).sum(1)
        return value, gradient

    def wall_points(self, axial: Array, steps: Array, spacing: float, *, offset: float, end: float) -> WallPoints:
        """Half of the wall x = 1 and an eighth of both caps; see :meth:`Channel.wall_points`."""
        side = 1.0 + offset
        count = max(int(np.ceil(side / spacing)), 2)
        across = (np.arange(count) + 0.5) * side / count
        z, y = (array.ravel() for array in np.meshgrid(axial, across, indexing="ij"))
        wall = np.column_stack([np.full_like(z, side), y, z])
        wall_area = np.repeat(steps, count) * side / count
        i, j = (array.ravel() for array in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
        inside = j <= i
        x, y, on_diagonal = across[i[inside]], across[j[inside]], (i == j)[inside]
        cap_area = (side / count) ** 2 * np.where(on_diagonal, 0.5, 1.0)
        caps = [np.column_stack([x, y, np.full_like(x, sign * (end + offset))]) for sign in (-1.0, 1.0)]
        return WallPoints(np.concatenate([wall, *caps]), np.concatenate([wall_area, cap_area, cap_area]))


def section_named(name: str) -> Channel:
    """The channel with the section called `name`."""
    from capsbayes.errors import InputError

    sections: dict[str, type[Channel]] = {SquareChannel.name: SquareChannel}
    if name not in sections:
        raise InputError("section", "", f"one of {', '.join(sections)}", repr(name))
    return sections[name]()
