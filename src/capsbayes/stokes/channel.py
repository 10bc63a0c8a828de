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

from capsbayes.errors import InputError

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
    def wall_points(self, axial: Array, steps: Array, cap_spacing: float, *, offset: float, end: float) -> WallPoints:
        """Points on the downstream half of the section's wall and on its end cap, moved outwards.

        Parameters
        ----------
        axial, steps : (m,) arrays
            Positive axial positions of the rings of points, and the length each stands for, which is also the
            distance of its points along the section's outline.
        cap_spacing : float
            Distance of the points on the cap.
        offset : float
            Distance of the points from the wall and from the cap over their spacing.
        end : float
            Axial position of the cap.
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

    def wall_points(self, axial: Array, steps: Array, cap_spacing: float, *, offset: float, end: float) -> WallPoints:
        """Half of the wall x = 1 and an eighth of the cap; see :meth:`Channel.wall_points`."""
        points, areas = [], []
        for z, step in zip(axial, steps, strict=True):
            side = 1.0 + offset * step
            across, width = _midpoints(side, step)
            points.append(np.column_stack([np.full_like(across, side), across, np.full_like(across, z)]))
            areas.append(np.full_like(across, step * width))
        across, width = _midpoints(1.0 + offset * cap_spacing, cap_spacing)
        i, j = (array.ravel() for array in np.meshgrid(np.arange(len(across)), np.arange(len(across)), indexing="ij"))
        i, j = i[j <= i], j[j <= i]
        points.append(np.column_stack([across[i], across[j], np.full(len(i), end + offset * cap_spacing)]))
        areas.append(width**2 * np.where(i == j, 0.5, 1.0))
        return WallPoints(np.concatenate(points), np.concatenate(areas))


def _midpoints(length: float, spacing: float) -> tuple[Array, float]:
    """Midpoints of equal steps of at most `spacing` that fill `length`, and the step."""
    count = max(int(np.ceil(length / spacing)), 2)
    return (np.arange(count) + 0.5) * length / count, length / count


def section_named(name: str) -> Channel:
    """The channel with the section called `name`."""
    sections: dict[str, type[Channel]] = {SquareChannel.name: SquareChannel}
    if name not in sections:
        raise InputError("section", "", f"one of {', '.join(sections)}", repr(name))
    return sections[name]()
