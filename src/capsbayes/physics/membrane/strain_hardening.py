"""A law between the neo-Hookean and Skalak's: rubber that hardens with strain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw, mixed
from capsbayes.physics.membrane.neo_hookean import NeoHookean
from capsbayes.physics.membrane.skalak import Skalak

_RUBBER, _HARDENING = NeoHookean(), Skalak(hardening=1.0)


@dataclass(frozen=True)
class StrainHardening(MembraneLaw):
    """Mixture of a share h of Skalak's energy with C = 1 and the neo-Hookean one: W = (1 - h) W_NH + h W_SK.

    Both have K_s = 3 G_s, so that h changes nothing at small strain: it is hardening alone, where the C of Skalak's
    law changes the resistance to area dilation as well.

    Parameters
    ----------
    strain_hardening : float
        The share h, from 0 (neo-Hookean) to 1 (Skalak, C = 1) [-].

    Examples
    --------
    A sheet stretched by one tenth in both directions:

    >>> StrainHardening(strain_hardening=0.5).principal_tensions([1.1, 1.1]).round(6).tolist()
    [0.603544, 0.603544]

    References
    ----------
    Barthes-Biesel, Diaz & Dhenin, J. Fluid Mech. 460 (2002) 211-222, compare the two laws.
    """

    strain_hardening: float = 0.0
    area_dilation_modulus: ClassVar[float] = 3.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.strain_hardening <= 1.0:
            raise InputError("StrainHardening", "strain_hardening", "a number from 0 to 1", str(self.strain_hardening))

    @property
    def name(self) -> str:
        """Name stored in databases."""
        if self.strain_hardening == 0.0:
            return _RUBBER.name
        share = np.format_float_positional(self.strain_hardening, trim="-")
        return f"{_RUBBER.name} with strain hardening h = {share}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        return mixed(self.strain_hardening, _RUBBER.derivatives(i1, i2), _HARDENING.derivatives(i1, i2))
