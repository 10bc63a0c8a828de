"""A family of laws with the area dilation modulus and the hardening free: from rubber to Skalak's law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import exprel

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw, mixed
from capsbayes.physics.membrane.skalak import Skalak

_LARGEST = 100.0  # modulus beyond which the power of a compressed area overflows


@dataclass(frozen=True)
class GeneralLaw(MembraneLaw):
    """Mixture of a share h of Skalak's energy and that of a Blatz-Ko sheet, W = (1 - h) W_BK + h W_SK.

    With m = (K - 1)/2 and K = K_s/G_s, W_BK = [I1 + ((1 + I2)^-m - 1)/m] / 2 is the foam-like rubber of Blatz and Ko in
    plane stress, which tends to [I1 - ln(1 + I2)] / 2 at K = 1, and W_SK is Skalak's energy with C = m. The moduli at
    small strain do not depend on h. The neo-Hookean law is K = 3, h = 0 and Skalak's is K = 1 + 2C, h = 1, both
    exactly; generalised Hooke's law is no member.

    Parameters
    ----------
    area_dilation_modulus : float
        K = K_s/G_s, from 1 to 100 [-]. Below 1 Skalak's part loses its tension as the area grows.
    strain_hardening : float
        The share h, from 0 to 1 [-].

    Examples
    --------
    A sheet stretched by one tenth in both directions:

    >>> GeneralLaw(area_dilation_modulus=2.0, strain_hardening=0.5).principal_tensions([1.1, 1.1]).round(6).tolist()
    [0.403884, 0.403884]

    References
    ----------
    Blatz & Ko, Trans. Soc. Rheol. 6 (1962) 223-251, doi:10.1122/1.548937; Skalak, Tozeren, Zarda & Chien,
    Biophys. J. 13 (1973) 245-264, doi:10.1016/S0006-3495(73)85983-1.
    """

    area_dilation_modulus: float = 3.0
    strain_hardening: float = 0.0

    def __post_init__(self) -> None:
        if not 1.0 <= self.area_dilation_modulus <= _LARGEST:
            expected, got = f"a number from 1 to {_LARGEST:g}", str(self.area_dilation_modulus)
            raise InputError("GeneralLaw", "area_dilation_modulus", expected, got)
        if not 0.0 <= self.strain_hardening <= 1.0:
            raise InputError("GeneralLaw", "strain_hardening", "a number from 0 to 1", str(self.strain_hardening))

    @property
    def name(self) -> str:
        """Name stored in databases."""
        values = self.area_dilation_modulus, self.strain_hardening
        modulus, share = (np.format_float_positional(value, trim="-") for value in values)
        return f"general K_s/G_s = {modulus}, h = {share}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        m = (self.area_dilation_modulus - 1.0) / 2.0
        growth = np.log1p(i2)
        power = np.exp(-m * growth) / (1.0 + i2)
        zero = np.zeros_like(i1)
        rubber = (
            0.5 * (i1 - growth * exprel(-m * growth)),
            zero + 0.5,
            -0.5 * power,
            zero,
            zero,
            0.5 * (m + 1.0) * power / (1.0 + i2),
        )
        return mixed(self.strain_hardening, rubber, Skalak(hardening=m).derivatives(i1, i2))
