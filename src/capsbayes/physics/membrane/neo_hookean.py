"""Neo-Hookean law: a thin sheet of incompressible rubber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw


@dataclass(frozen=True)
class NeoHookean(MembraneLaw):
    """Neo-Hookean membrane, W = (I1 - 1 + 1/(I2 + 1)) / 2.

    The sheet keeps its volume: it thins where its area grows. It softens at
    large strain and has no parameter other than G_s; K_s = 3 G_s. Codes that use
    the Young modulus E_s = 3 G_s have capillary numbers three times smaller.

    Examples
    --------
    A sheet stretched by one tenth in both directions:

    >>> NeoHookean().principal_tensions([1.1, 1.1]).round(6).tolist()
    [0.435526, 0.435526]

    References
    ----------
    Barthes-Biesel, Diaz & Dhenin, J. Fluid Mech. 460 (2002) 211-222.
    """

    name: ClassVar[str] = "neo-Hookean"
    area_dilation_modulus: ClassVar[float] = 3.0

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        thinning = 1.0 / (i2 + 1.0)  # square of the thickness over that at rest
        zero = np.zeros_like(thinning)
        return (
            0.5 * (i1 - 1.0 + thinning),
            np.full_like(thinning, 0.5),
            -0.5 * thinning**2,
            zero,
            zero.copy(),
            thinning**3,
        )
