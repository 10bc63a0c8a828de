"""A law between the neo-Hookean and generalised Hooke's: stiffer in extension, softer in compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.physics.membrane.hooke import GeneralisedHooke
from capsbayes.physics.membrane.law import InvariantDerivatives, MembraneLaw, mixed
from capsbayes.physics.membrane.neo_hookean import NeoHookean

_RUBBER, _HOOKE = NeoHookean(), GeneralisedHooke(poisson_ratio=0.5)


@dataclass(frozen=True)
class HookeShare(MembraneLaw):
    """Mixture of a share s of generalised Hooke's energy with nu_s = 1/2 and the neo-Hookean: (1 - s) W_NH + s W_H."""

    # Both have K_s = 3 G_s, so that the share changes nothing at small strain. Barthes-Biesel, Diaz & Dhenin, J. Fluid
    # Mech. 460 (2002) 211-222, compare the two laws.

    hooke_share: float = 0.0
    area_dilation_modulus: ClassVar[float] = 3.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.hooke_share <= 1.0:
            raise InputError("HookeShare", "hooke_share", "a number from 0 to 1", str(self.hooke_share))

    @property
    def name(self) -> str:
        """Name stored in databases."""
        if self.hooke_share in (0.0, 1.0):
            return (_HOOKE if self.hooke_share else _RUBBER).name
        share = np.format_float_positional(self.hooke_share, trim="-")
        return f"{_RUBBER.name} with a share {share} of {_HOOKE.name}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants; see `MembraneLaw.derivatives`."""
        return mixed(self.hooke_share, _RUBBER.derivatives(i1, i2), _HOOKE.derivatives(i1, i2))
