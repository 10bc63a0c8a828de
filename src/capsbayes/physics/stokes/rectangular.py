"""Channels of rectangular and square cross-section, with the Fourier series of their flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.stokes.channel import Channel, midpoints, unidirectional
from capsbayes.physics.surface.symmetry import D2, D4, Symmetry

_ODD = np.arange(1, 160, 2)
_RATE = 0.5 * np.pi * _ODD
_SIGN = (-1.0) ** ((_ODD - 1) // 2)
_SERIES = 16 / np.pi**3 * _SIGN / _ODD**3


def _pressure_gradient(depth: float) -> float:
    """Return -(dp/dz) l^2 / (mu U) in the rectangle |x| <= `depth`, |y| <= 1 (White, Viscous Fluid Flow, 3-48)."""
    return float(1.0 / (depth**2 * (1 / 3 - np.sum(64 * depth * np.tanh(_RATE / depth) / (np.pi * _ODD) ** 5))))


def _flow(points: Floats, depth: float) -> tuple[Floats, Floats]:
    """Compute the undisturbed flow in the rectangle |x| <= `depth`, |y| <= 1; see `Flow.undisturbed`."""
    x, y = points[:, :1] / depth, points[:, 1:2] / depth
    cosine, sine = np.cos(_RATE * x), np.sin(_RATE * x)
    # cosh(k y)/cosh(k / depth) without overflow
    rise, fall = np.exp(_RATE * (np.abs(y) - 1 / depth)), np.exp(-_RATE * (np.abs(y) + 1 / depth))
    even = (rise + fall) / (1 + np.exp(-2 * _RATE / depth))
    odd = np.sign(y) * (rise - fall) / (1 + np.exp(-2 * _RATE / depth))
    scale = _pressure_gradient(depth) * depth
    return unidirectional(
        0.5 * scale * depth * ((1 - x[:, 0] ** 2) - 2 * (_SERIES * cosine * even).sum(1)),
        scale * (-x[:, 0] + (_SERIES * _RATE * sine * even).sum(1)),
        -scale * (_SERIES * _RATE * cosine * odd).sum(1),
    )


@dataclass(frozen=True)
class RectangularChannel(Channel):
    """Rectangular cross-section |x| <= aspect, |y| <= 1, with x along the direction of view."""

    aspect: float

    name: ClassVar[str] = "rectangular"
    symmetry: ClassVar[Symmetry] = D2

    def __post_init__(self) -> None:
        if not 0.5 <= self.aspect <= 2.0:
            raise InputError("cross_section", "section_aspect", "a number from 0.5 to 2", str(self.aspect))

    @property
    def area(self) -> float:
        """Area of the cross-section over l^2."""
        return 4.0 * self.aspect

    @property
    def pressure_gradient(self) -> float:
        """-(dp/dz) l^2 / (mu U) of the undisturbed flow."""
        return _pressure_gradient(self.aspect)

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Sum the Fourier series; see `Flow.undisturbed`."""
        return _flow(points, self.aspect)

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points on half of the wall x = aspect and half of y = 1; see `Channel.outline`."""
        depth, width = self.aspect + outwards, 1.0 + outwards
        x, x_step = midpoints(depth, spacing)
        y, y_step = midpoints(width, spacing)
        side = np.column_stack([np.full_like(y, depth), y])
        top = np.column_stack([x, np.full_like(x, width)])
        return np.concatenate([side, top]), np.repeat([y_step, x_step], [len(y), len(x)])

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return a grid on the quarter 0 <= x, y; see `Channel.filling`."""
        x, x_step = midpoints(self.aspect + outwards, spacing)
        y, y_step = midpoints(1.0 + outwards, spacing)
        points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        return points, np.full(len(points), x_step * y_step)


@dataclass(frozen=True)
class SquareChannel(Channel):
    """Square cross-section of half width one: a rectangle with twice its symmetry."""

    name: ClassVar[str] = "square"
    symmetry: ClassVar[Symmetry] = D4
    area: ClassVar[float] = 4.0
    pressure_gradient: ClassVar[float] = _pressure_gradient(1.0)

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Sum the Fourier series; see `Flow.undisturbed`."""
        return _flow(points, 1.0)

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points on half of the wall x = 1; see `Channel.outline`."""
        side = 1.0 + outwards
        across, step = midpoints(side, spacing)
        return np.column_stack([np.full_like(across, side), across]), np.full_like(across, step)

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return a grid on the eighth 0 <= y <= x; see `Channel.filling`."""
        across, step = midpoints(1.0 + outwards, spacing)
        i, j = np.tril_indices(len(across))
        return np.column_stack([across[i], across[j]]), step**2 * np.where(i == j, 0.5, 1.0)
