"""Generalised Hooke's law: linear elasticity of a thin sheet, for large displacements by Green's strain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw


@dataclass(frozen=True)
class GeneralisedHooke(MembraneLaw):
    """Membrane with an energy quadratic in Green's strain, W = I1^2 / (4 (1 - nu_s)) + (I1 - I2) / 2.

    With the principal Green strains e = (l^2 - 1) / 2 this is W = e1^2 + e2^2 + nu_s / (1 - nu_s) (e1 + e2)^2.
    K_s = (1 + nu_s) / (1 - nu_s) G_s. A law for small strains: it softens under strong compression.

    Parameters
    ----------
    poisson_ratio : float
        Surface Poisson ratio nu_s, between -1 and 1 [-]; 1/2 is a thin sheet of rubber, 1 would keep its area.

    Examples
    --------
    A sheet stretched by one tenth in both directions:

    >>> GeneralisedHooke(poisson_ratio=0.5).principal_tensions([1.1, 1.1]).round(6).tolist()
    [0.63, 0.63]

    References
    ----------
    Barthes-Biesel, Diaz & Dhenin, J. Fluid Mech. 460 (2002) 211-222.
    """

    poisson_ratio: float = 0.5

    def __post_init__(self) -> None:
        if not -1.0 < self.poisson_ratio < 1.0:
            raise InputError("GeneralisedHooke", "poisson_ratio", "a number between -1 and 1", str(self.poisson_ratio))

    @property
    def name(self) -> str:
        """Name stored in databases."""
        return f"generalised Hooke nu_s = {np.format_float_positional(self.poisson_ratio, trim='-')}"

    @property
    def area_dilation_modulus(self) -> float:
        """Area dilation modulus K_s / G_s [-]."""
        return (1.0 + self.poisson_ratio) / (1.0 - self.poisson_ratio)

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        curvature = 0.5 / (1.0 - self.poisson_ratio)
        return (
            0.5 * (curvature * i1**2 + i1 - i2),
            curvature * i1 + 0.5,
            np.full_like(i1, -0.5),
            np.full_like(i1, curvature),
            np.zeros_like(i1),
            np.zeros_like(i1),
        )
