"""Skalak's law: a sheet that hardens with strain and may resist area dilation more than shear."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw

_HARDEST = 1e6  # beyond it the area of the membrane cannot change in double precision


@dataclass(frozen=True)
class Skalak(MembraneLaw):
    """Skalak's membrane, W = (I1^2 + 2 I1 - 2 I2 + C I2^2) / 4.

    With the principal Green strains e = (l^2 - 1) / 2 this is W = e1^2 + e2^2 + C I2^2 / 4: C sets the
    resistance to area dilation, K_s = (1 + 2 C) G_s, and the sheet hardens as it stretches.

    Parameters
    ----------
    hardening : float
        The C of the law, above -1/2 [-]. If it is negative the energy decreases again at large strain.

    Examples
    --------
    A sheet stretched by one tenth in both directions:

    >>> Skalak(hardening=1.0).principal_tensions([1.1, 1.1]).round(6).tolist()
    [0.771561, 0.771561]

    References
    ----------
    Skalak, Tozeren, Zarda & Chien, Biophys. J. 13 (1973) 245-264, doi:10.1016/S0006-3495(73)85983-1.
    """

    hardening: float = 1.0

    def __post_init__(self) -> None:
        if not -0.5 < self.hardening < math.inf:
            raise InputError("Skalak", "hardening", "a finite number above -0.5", str(self.hardening))
        if self.hardening > _HARDEST:
            raise InputError("Skalak", "hardening", f"a number of at most {_HARDEST:g}", str(self.hardening))

    @property
    def name(self) -> str:
        """Name stored in databases."""
        return f"Skalak C = {np.format_float_positional(self.hardening, trim='-')}"

    @property
    def area_dilation_modulus(self) -> float:
        """Area dilation modulus K_s / G_s [-]."""
        return 1.0 + 2.0 * self.hardening

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        c = self.hardening
        return (
            0.25 * (i1**2 + 2.0 * i1 - 2.0 * i2 + c * i2**2),
            0.5 * (i1 + 1.0),
            0.5 * (c * i2 - 1.0),
            np.full_like(i1, 0.5),
            np.zeros_like(i1),
            np.full_like(i1, 0.5 * c),
        )
