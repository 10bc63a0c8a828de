"""An axisymmetric neo-Hookean shell with Koiter's bending energy, by polynomials of the cosine of latitude.

It shares nothing with the finite elements of the library: the meridian (r, z) of a unit sphere at rest is
r = sin(t) P(cos t), z = Q(cos t), curvatures are those of the meridian and the parallel, and the energy is summed over
Gauss points. Derivatives of the energy density are taken in the complex plane.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

POISSON_RATIO = 0.5


def density(jet, sine, bending):
    """Energy over G_s per area at rest of a jet (5, q): r, r', r'', z', z''."""
    r, r1, r2, z1, z2 = jet
    along, around = r1**2 + z1**2, (r / sine) ** 2
    stretching = (along + around + 1 / (along * around) - 3) / 2
    first = (r1 * z2 - z1 * r2) / np.sqrt(along) + 1
    second = z1 * r / (np.sqrt(along) * sine**2) + 1
    bent = (1 - POISSON_RATIO) * (first**2 + second**2) + POISSON_RATIO * (first + second) ** 2
    return stretching + bending * bent / 2


def density_slopes(jet, sine, bending):
    """Gradient (5, q), by complex steps."""
    step = 1e-30j * np.eye(5)
    return np.array([density(jet + change[:, None], sine, bending).imag / 1e-30 for change in step])


class AxisymmetricShell:
    """Equilibrium of a shell whose poles are pressed in by springs along its axis.

    The springs have the energy 1/2 k int cos(t)^8 (z - h cos t)^2 dS_0; B is over G_s a^2, k over G_s/a^2.
    """

    def __init__(self, bending, stiffness, degree=60):
        self.bending, self.degree = bending, degree
        c, weight = legendre.leggauss(4 * degree)
        self.sine, self.weight = np.sqrt(1 - c**2), 2 * np.pi * weight
        p = legendre.legvander(c, degree)
        unit = np.eye(degree + 1)
        p1, p2 = (legendre.legval(c, legendre.legder(unit, order)).T for order in (1, 2))
        s, c, q, zero = self.sine[:, None], c[:, None], degree + 1, np.zeros_like(p)
        d1, d2 = -s * p1, s**2 * p2 - c * p1  # along the latitude
        radial = s * p, c * p + s * d1, -s * p + 2 * c * d1 + s * d2
        self.jets = np.stack([np.hstack([one, zero]) for one in radial] + [np.hstack([zero, one]) for one in (d1, d2)])
        spring = stiffness * self.weight * c[:, 0] ** 8
        self.springs = np.zeros((2 * q, 2 * q))
        self.springs[q:, q:] = p.T @ (spring[:, None] * p)

    def pressed(self, heights):
        """Return the coefficients with the springs at the last of some heights h, in turn."""
        x = np.zeros(2 * self.degree + 2)
        x[0] = x[self.degree + 2] = 1.0
        for height in heights:
            target = np.zeros_like(x)
            target[self.degree + 2] = height
            for _ in range(30):
                jet = self.jets @ x
                slopes = density_slopes(jet, self.sine, self.bending)
                step = 1e-6
                second = np.array(
                    [
                        density_slopes(jet + change[:, None], self.sine, self.bending)
                        - density_slopes(jet - change[:, None], self.sine, self.bending)
                        for change in step * np.eye(5)
                    ]
                ) / (2 * step)
                gradient = np.einsum("jq,jqn->n", self.weight * slopes, self.jets) + self.springs @ (x - target)
                tangent = np.einsum("jqm,jkq,kqn->mn", self.jets, self.weight * second, self.jets, optimize=True)
                change = np.linalg.solve(tangent + self.springs, -gradient)
                x += change * min(1.0, 0.1 / np.max(np.abs(change)))
                if np.max(np.abs(change)) < 1e-10:
                    break
            else:
                raise ArithmeticError("the shell does not come to rest")
        return x

    def meridian(self, x, latitude):
        """Return (r, z) at polar angles (p,)."""
        c, half = np.cos(latitude), self.degree + 1
        return np.sin(latitude) * legendre.legval(c, x[:half]), legendre.legval(c, x[half:])
