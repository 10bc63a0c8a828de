"""The law of Evans and Skalak: shear at constant area and change of area store their energies apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw

_LARGEST = 1e6  # modulus beyond which the area cannot change in double precision


@dataclass(frozen=True)
class EvansSkalak(MembraneLaw):
    """Membrane with W = K (J - 1)^2 / 2 + (l1/l2 + l2/l1) / 2 - 1, where J = l1 l2 and K = K_s/G_s.

    Parameters
    ----------
    area_dilation_modulus : float
        K = K_s/G_s, positive [-].

    Examples
    --------
    A sheet stretched by one tenth in both directions:

    >>> EvansSkalak(area_dilation_modulus=3.0).principal_tensions([1.1, 1.1]).round(6).tolist()
    [0.63, 0.63]

    References
    ----------
    Evans & Skalak, Mechanics and Thermodynamics of Biomembranes, CRC Press 1980.
    """

    area_dilation_modulus: float = 3.0

    def __post_init__(self) -> None:
        if not 0.0 < self.area_dilation_modulus <= _LARGEST:
            expected, got = f"a positive number of at most {_LARGEST:g}", str(self.area_dilation_modulus)
            raise InputError("EvansSkalak", "area_dilation_modulus", expected, got)

    @property
    def name(self) -> str:
        """Name stored in databases."""
        return f"Evans-Skalak K_s/G_s = {np.format_float_positional(self.area_dilation_modulus, trim='-')}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        modulus, squares, area = self.area_dilation_modulus, i1 + 2.0, np.sqrt(1.0 + i2)
        growth = i2 / (1.0 + area)  # J - 1 without cancellation
        apart = (i1 - 2.0 * growth) / (2.0 * area)  # (l1 - l2)^2 / (2 J)
        return (
            0.5 * modulus * growth**2 + apart,
            0.5 / area,
            0.5 * modulus * growth / area - 0.25 * squares / area**3,
            np.zeros_like(i1),
            -0.25 / area**3,
            0.25 * modulus / area**3 + 0.375 * squares / area**5,
        )
