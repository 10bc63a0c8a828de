"""Channels by their cross-section: walls, undisturbed flow, mean velocity."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.surface import C_INF_V, D2, D4, Symmetry

# Undisturbed flows and straight channels: what all cross-sections share.
#
# Lengths are over the half width l, velocities over the mean velocity U. The flow is along z; the picture shows y, in
# which the half width is one; x is the direction of view


class Flow(ABC):
    """An undisturbed flow and its symmetry."""

    symmetry: ClassVar[Symmetry]

    @property
    @abstractmethod
    def pressure_gradient(self) -> float:
        """-(dp/dz) l^2 / (mu U) of the undisturbed flow."""

    @abstractmethod
    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the velocity (p, 3) at `points` (p, 3) and its gradient (p, 3, 3), [p, i, j] that of v_i along j."""


class Channel(Flow):
    """A straight channel along z; a subclass places the points of its cross-section in the wedge of its symmetry."""

    # The wedge is 0 <= y <= x under D4 and 0 <= x, y under D2.

    name: ClassVar[str]

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of the cross-section over l^2."""

    @abstractmethod
    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points (p, 2) `spacing` apart on the wall moved `outwards`, and the length (p,) of each."""

    @abstractmethod
    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return points (p, 2) `spacing` apart that fill the widened cross-section, and the area (p,) of each."""

    def wall_points(
        self, axial: Floats, steps: Floats, cap_spacing: float, *, offset: float, end: float
    ) -> tuple[Floats, Floats]:
        """Return points (p, 3) on the downstream wall and its end cap, moved outwards, and the areas they stand for."""
        # One point of each orbit. `axial`, `steps` (m,): positions of the rings of points and the length each stands
        # for, also the distance of its points along the outline; `offset`: distance from wall and cap over the spacing;
        # `end`: of the cap.
        points, areas = [], []
        for z, step in zip(axial, steps, strict=True):
            ring, lengths = self.outline(step, offset * step)
            points.append(_at(ring, z))
            areas.append(step * lengths)
        cap, cap_areas = self.filling(cap_spacing, offset * cap_spacing)
        points.append(_at(cap, end + offset * cap_spacing))
        areas.append(cap_areas)
        return np.concatenate(points), np.concatenate(areas)


def _at(points: Floats, z: float) -> Floats:
    return np.column_stack([points, np.full(len(points), z)])


def midpoints(length: float, spacing: float) -> tuple[Floats, float]:
    """Return the midpoints of equal steps of at most `spacing` that fill `length`, and the step.

    >>> midpoints(1.0, 0.3)
    (array([0.125, 0.375, 0.625, 0.875]), 0.25)
    """
    count = int(np.ceil(length / spacing))
    return (np.arange(count) + 0.5) * length / count, length / count


def unidirectional(axial: Floats, along_x: Floats, along_y: Floats) -> tuple[Floats, Floats]:
    """Return velocity (p, 3) and gradient (p, 3, 3) of a flow along z from its axial component and its slopes (p,)."""
    velocity, gradient = np.zeros((len(axial), 3)), np.zeros((len(axial), 3, 3))
    velocity[:, 2], gradient[:, 2, 0], gradient[:, 2, 1] = axial, along_x, along_y
    return velocity, gradient


# Channels of rectangular and square cross-section, with the Fourier series of their flow

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
        return 4.0 * self.aspect

    @property
    def pressure_gradient(self) -> float:
        return _pressure_gradient(self.aspect)

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        return _flow(points, self.aspect)

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        depth, width = self.aspect + outwards, 1.0 + outwards
        x, x_step = midpoints(depth, spacing)
        y, y_step = midpoints(width, spacing)
        side = np.column_stack([np.full_like(y, depth), y])
        top = np.column_stack([x, np.full_like(x, width)])
        return np.concatenate([side, top]), np.repeat([y_step, x_step], [len(y), len(x)])

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
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
        return _flow(points, 1.0)

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        side = 1.0 + outwards
        across, step = midpoints(side, spacing)
        return np.column_stack([np.full_like(across, side), across]), np.full_like(across, step)

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        across, step = midpoints(1.0 + outwards, spacing)
        i, j = np.tril_indices(len(across))
        return np.column_stack([across[i], across[j]]), step**2 * np.where(i == j, 0.5, 1.0)


# Points on and within a square with rounded corners, of which the circle is the limit


def _along(radius: float, spacing: float, outwards: float) -> tuple[Floats, Floats, float]:
    """Return the points (p, 2) of the eighth, their normals (p, 2) and the length of each."""
    straight, turn = 1.0 - radius, radius + outwards
    along, step = midpoints(straight + np.pi / 4 * turn, spacing)
    angle = np.maximum(along - straight, 0.0) / turn
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    middles = np.column_stack([np.full_like(along, straight), np.minimum(along, straight)])
    return middles + turn * normals, normals, step


def rounded_outline(radius: float, spacing: float, outwards: float) -> tuple[Floats, Floats]:
    """Return the eighth 0 <= y <= x of the outline; see `Channel.outline`. A circle has corners of radius 1."""
    points, _, step = _along(radius, spacing, outwards)
    return points, np.full(len(points), step)


def rounded_filling(radius: float, spacing: float, outwards: float) -> tuple[Floats, Floats]:
    """Return rings, each a smaller outline, that fill the eighth; see `Channel.filling`."""
    scales, scale_step = midpoints(1.0, spacing / (1.0 + outwards))
    rings, areas = [], []
    for scale in scales:
        points, normals, step = _along(radius, spacing / scale, outwards)
        rings.append(scale * points)
        areas.append(scale * scale_step * np.sum(points * normals, axis=1) * step)
    return np.concatenate(rings), np.concatenate(areas)


# Channel of circular cross-section


@dataclass(frozen=True)
class CircularChannel(Channel):
    """Circular tube of radius one, in which capsules are axisymmetric."""

    name: ClassVar[str] = "circular"
    symmetry: ClassVar[Symmetry] = C_INF_V
    area: ClassVar[float] = float(np.pi)
    pressure_gradient: ClassVar[float] = 8.0

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        x, y = points[:, 0], points[:, 1]
        return unidirectional(2.0 * (1.0 - x**2 - y**2), -4.0 * x, -4.0 * y)

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        return rounded_outline(1.0, spacing, outwards)

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        return rounded_filling(1.0, spacing, outwards)


@dataclass(frozen=True)
class FourfoldTube(CircularChannel):
    """Circular tube in which capsules have only the symmetry of the mesh, as when they wrinkle."""

    symmetry: ClassVar[Symmetry] = D4


# Channel of square cross-section with rounded corners, and the flow in it.
#
# The axial velocity is w = dp (h - r^2 / 4) with h harmonic and equal to r^2 / 4 on the wall. With the cross-section's
# symmetry, h = Re F(Z) of Z = (x + i y)^4, where F has real coefficients. F is fitted on the wall by a polynomial and
# by poles that crowd, from outside, towards the points where straight walls become arcs: there the wall's curvature
# jumps, and a polynomial alone would converge slowly (Gopal & Trefethen 2019, doi 10.1137/19M125947X)

Complex = NDArray[np.complexfloating[Any, Any]]

_DEGREE, _POLES, _SAMPLES = 12, 20, 150
_NEAREST, _FARTHEST = 1e-3, 2.0  # pole from the jump of curvature: the nearest over the corner's radius


class _Harmonic(NamedTuple):
    """F(Z) = sum_j c_j Z^j + sum_k (r_k / (Z - p_k) + its conjugate partner), and dp/dz for a mean velocity of one."""

    coefficients: Floats
    poles: Complex
    residues: Complex
    pressure_gradient: float

    def at(self, z: Complex) -> tuple[Floats, Floats, Floats]:
        """Compute h and its derivatives along x and y at z = x + i y (p,)."""
        fourth = z**4
        powers = np.polynomial.Polynomial(self.coefficients)
        apart = 1.0 / (fourth[:, None] - self.poles), 1.0 / (fourth[:, None] - self.poles.conj())
        value = powers(fourth) + apart[0] @ self.residues + apart[1] @ self.residues.conj()
        slope = powers.deriv()(fourth) - apart[0] ** 2 @ self.residues - apart[1] ** 2 @ self.residues.conj()
        slope = slope * 4.0 * z**3
        return value.real, slope.real, -slope.imag


def _wall(radius: float, share: Floats) -> tuple[Complex, Complex]:
    """Return points of the straight wall and of the arc at these shares of each, from where they meet."""
    straight = 1.0 + 1j * (1.0 - radius) * (1.0 - share)
    return straight, (1.0 - radius) * (1 + 1j) + radius * np.exp(0.25j * np.pi * share)


@lru_cache(maxsize=64)
def _harmonic(radius: float) -> _Harmonic:
    """Fit h on the wall by least squares."""
    share = np.concatenate([np.geomspace(1e-6, 1.0, _SAMPLES), np.linspace(0.0, 1.0, _SAMPLES)])
    z = np.concatenate(_wall(radius, share))
    junction = 1.0 + 1j * (1.0 - radius)
    poles = (junction + np.geomspace(_NEAREST * radius, _FARTHEST, _POLES)) ** 4
    powers = z[:, None] ** (4 * np.arange(_DEGREE + 1))
    apart = 1.0 / (z[:, None] ** 4 - poles), 1.0 / (z[:, None] ** 4 - poles.conj())
    columns = np.hstack([powers.real, (apart[0] + apart[1]).real, (1j * (apart[0] - apart[1])).real])
    sizes = np.linalg.norm(columns, axis=0)
    fit = np.linalg.lstsq(columns / sizes, np.abs(z) ** 2 / 4, rcond=1e-14)[0] / sizes
    coefficients, real, imaginary = np.split(fit, [_DEGREE + 1, _DEGREE + 1 + _POLES])
    harmonic = _Harmonic(coefficients, poles, real + 1j * imaginary, 1.0)
    return harmonic._replace(pressure_gradient=_area(radius) / _flow_rate(harmonic, radius))


def _area(radius: float) -> float:
    return 4.0 - (4.0 - np.pi) * radius**2


def _flow_rate(harmonic: _Harmonic, radius: float) -> float:
    """Integrate h - r^2 / 4 over the cross-section, along rays from the axis to the wall."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    share, weight = (nodes + 1.0) / 2, weights / 2
    straight, arc = _wall(radius, share)
    normals = np.concatenate([np.ones_like(straight), np.exp(0.25j * np.pi * share)])
    lengths = np.concatenate([(1.0 - radius) * weight, 0.25 * np.pi * radius * weight])
    wall = np.concatenate([straight, arc])
    z = (share[:, None] * wall).ravel()
    area = np.outer(weight * share, (wall * normals.conj()).real * lengths).ravel()
    return float(8.0 * area @ (harmonic.at(z)[0] - np.abs(z) ** 2 / 4))


@dataclass(frozen=True)
class RoundedSquareChannel(Channel):
    """Square cross-section of half width one whose corners are arcs of radius `corner_radius`, from 0 to 1.

    >>> round(RoundedSquareChannel(0.2).pressure_gradient, 4)
    7.0671
    """

    corner_radius: float

    name: ClassVar[str] = "square"
    symmetry: ClassVar[Symmetry] = D4

    def __post_init__(self) -> None:
        if not 0.0 < self.corner_radius < 1.0:
            raise InputError("cross_section", "corner_radius", "a number between 0 and 1", str(self.corner_radius))

    @property
    def area(self) -> float:
        return _area(self.corner_radius)

    @property
    def pressure_gradient(self) -> float:
        return _harmonic(self.corner_radius).pressure_gradient

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        x, y = points[:, 0], points[:, 1]
        harmonic = _harmonic(self.corner_radius)
        value, along_x, along_y = harmonic.at(x + 1j * y)
        scale = harmonic.pressure_gradient
        return unidirectional(scale * (value - (x**2 + y**2) / 4), scale * (along_x - x / 2), scale * (along_y - y / 2))

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        return rounded_outline(self.corner_radius, spacing, outwards)

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        return rounded_filling(self.corner_radius, spacing, outwards)


# The channels by the names of their cross-sections

_NAMES = (SquareChannel.name, RectangularChannel.name, CircularChannel.name)


def cross_section_named(name: str, corner_radius: float = 0.0, aspect: float = 1.0) -> Channel:
    """Return the channel ``"square"``, ``"rectangular"`` or ``"circular"``; refuse another name."""
    # `corner_radius` [l] of a square; `aspect`: depth along the direction of view over the width seen, b / l.
    if name not in _NAMES:
        raise InputError("cross_section", "", f"one of {', '.join(_NAMES)}", repr(name))
    if corner_radius != 0.0 and (name != SquareChannel.name or aspect != 1.0):
        expected = "0, or a square cross-section of equal sides"
        raise InputError("cross_section", "corner_radius", expected, f"{corner_radius:g}")
    if name == CircularChannel.name:
        if aspect != 1.0:
            raise InputError("cross_section", "section_aspect", "1 for a circular cross-section", f"{aspect:g}")
        return CircularChannel()
    if corner_radius != 0.0:
        return RoundedSquareChannel(corner_radius)
    return SquareChannel() if name == SquareChannel.name and aspect == 1.0 else RectangularChannel(aspect)
