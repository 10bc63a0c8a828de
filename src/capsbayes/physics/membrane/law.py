"""The interface of membrane laws: their energy as a function of the two strain invariants.

A law is an isotropic, thin, hyperelastic sheet. Its energy W, per unit area
*at rest* and over the surface shear modulus G_s, is a function of the Skalak
invariants of the in-plane principal stretches l1, l2,

    I1 = l1^2 + l2^2 - 2,        I2 = l1^2 l2^2 - 1,

so that G_s = 1 for every law. Everything else follows from W and its first
and second derivatives with respect to I1 and I2.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats

InvariantDerivatives = tuple[Floats, Floats, Floats, Floats, Floats, Floats]


def mixed(share: float, soft: InvariantDerivatives, hard: InvariantDerivatives) -> InvariantDerivatives:
    """Return the derivatives of the energy (1 - share) W_soft + share W_hard."""
    w, w1, w2, w11, w12, w22 = ((1.0 - share) * one + share * other for one, other in zip(soft, hard, strict=True))
    return w, w1, w2, w11, w12, w22


@dataclass(frozen=True)
class MembraneLaw(abc.ABC):
    """Abstract law of an isotropic hyperelastic membrane, over G_s.

    A subclass is a frozen dataclass of the parameters of the law and defines `name`, `area_dilation_modulus` and
    `derivatives`. `capsbayes.testing.check_law` checks that they agree with each other.
    """

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Name of the law and its parameters, as shown and stored in databases."""

    @property
    @abc.abstractmethod
    def area_dilation_modulus(self) -> float:
        """Area dilation modulus at small strain K_s / G_s [-]."""

    @abc.abstractmethod
    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        """Compute the energy and its derivatives with respect to the invariants, all over G_s.

        Parameters
        ----------
        i1, i2 : (...) array [-]
            Skalak invariants, of one shape; `i2` > -1.

        Returns
        -------
        w, w1, w2, w11, w12, w22 : (...) arrays [-]
            W, dW/dI1, dW/dI2, d2W/dI1^2, d2W/dI1 dI2, d2W/dI2^2, each new and
            of the shape of `i1`.
        """

    def energy(self, i1: ArrayLike, i2: ArrayLike) -> Floats:
        """Compute the energy per unit area at rest, over G_s.

        Parameters
        ----------
        i1, i2 : (...) array [-]
            Skalak invariants.

        Returns
        -------
        (...) array [-]
        """
        first, second = np.broadcast_arrays(np.asarray(i1, dtype=float), np.asarray(i2, dtype=float))
        return self.derivatives(first, second)[0]

    def principal_tensions(self, stretch: ArrayLike) -> Floats:
        """Compute the principal Cauchy tensions, over G_s.

        The tension along the first direction is tau_1 = (1/l2) dW/dl1: the
        force per unit *deformed* length. In terms of the invariants it has no
        division by l1 - l2.

        Parameters
        ----------
        stretch : (..., 2) array [-]
            Principal stretches l1, l2, both positive.

        Returns
        -------
        (..., 2) array [-]
            tau_1, tau_2.
        """
        l1, l2 = np.moveaxis(np.asarray(stretch, dtype=float), -1, 0)
        _, w1, w2, *_ = self.derivatives(l1**2 + l2**2 - 2.0, (l1 * l2) ** 2 - 1.0)
        isotropic = 2.0 * w2 * l1 * l2
        return np.stack([2.0 * w1 * l1 / l2 + isotropic, 2.0 * w1 * l2 / l1 + isotropic], axis=-1)
