"""Channel of square cross-section with rounded corners, and the flow in it.

The axial velocity is w = dp (h - r^2 / 4) with h harmonic and equal to r^2 / 4
on the wall. With the cross-section's symmetry, h = Re F(Z) of Z = (x + i y)^4, where
F has real coefficients. F is fitted on the wall by a polynomial and by poles
that crowd, from outside, towards the points where straight walls become arcs:
there the wall's curvature jumps, and a polynomial alone would converge slowly
(Gopal & Trefethen 2019, doi 10.1137/19M125947X).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.stokes.channel import Channel, unidirectional
from capsbayes.physics.stokes.rounded_outline import rounded_filling, rounded_outline
from capsbayes.physics.surface.symmetry import D4, Symmetry

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
        """Area of the cross-section over l^2."""
        return _area(self.corner_radius)

    @property
    def pressure_gradient(self) -> float:
        """-(dp/dz) l^2 / (mu U) of the undisturbed flow."""
        return _harmonic(self.corner_radius).pressure_gradient

    def undisturbed(self, points: Floats) -> tuple[Floats, Floats]:
        """Add the parabola and the harmonic part; see `Flow.undisturbed`."""
        x, y = points[:, 0], points[:, 1]
        harmonic = _harmonic(self.corner_radius)
        value, along_x, along_y = harmonic.at(x + 1j * y)
        scale = harmonic.pressure_gradient
        return unidirectional(scale * (value - (x**2 + y**2) / 4), scale * (along_x - x / 2), scale * (along_y - y / 2))

    def outline(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return an eighth of the outline; see `Channel.outline`."""
        return rounded_outline(self.corner_radius, spacing, outwards)

    def filling(self, spacing: float, outwards: float) -> tuple[Floats, Floats]:
        """Return rings on an eighth of the cross-section; see `Channel.filling`."""
        return rounded_filling(self.corner_radius, spacing, outwards)
