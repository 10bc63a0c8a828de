"""Membrane laws: elastic energy and tensions of a thin sheet, over its surface shear modulus G_s."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import exprel

from capsbayes.arrays import Floats
from capsbayes.errors import InputError

# The interface of membrane laws: their energy as a function of the two strain invariants.
#
# A law is an isotropic, thin, hyperelastic sheet. Its energy W, per unit area *at rest* and over the surface shear
# modulus G_s, is a function of the Skalak invariants of the in-plane principal stretches l1, l2,
#
#     I1 = l1^2 + l2^2 - 2,        I2 = l1^2 l2^2 - 1,
#
# so that G_s = 1 for every law. Everything else follows from W and its first
# and second derivatives with respect to I1 and I2

InvariantDerivatives = tuple[Floats, Floats, Floats, Floats, Floats, Floats]

_STIFFEST = 1e6  # area dilation modulus beyond which the area cannot change in double precision


def mixed(share: float, soft: InvariantDerivatives, hard: InvariantDerivatives) -> InvariantDerivatives:
    """Return the derivatives of the energy (1 - share) W_soft + share W_hard."""
    w, w1, w2, w11, w12, w22 = (
        (1.0 - share) * of_soft + share * of_hard for of_soft, of_hard in zip(soft, hard, strict=True)
    )
    return w, w1, w2, w11, w12, w22


def _shown(value: float) -> str:
    """Return a parameter with all its digits, as names of laws have it."""
    return np.format_float_positional(value, trim="-")


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
            W, dW/dI1, dW/dI2, d2W/dI1^2, d2W/dI1 dI2, d2W/dI2^2, each new and of the shape of `i1`.
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

        The tension along the first direction is tau_1 = (1/l2) dW/dl1: the force per unit *deformed* length. In terms
        of the invariants it has no division by l1 - l2.

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

    def _check(self, name: str, allowed: bool, expected: str) -> None:
        """Refuse a parameter that is not allowed."""
        if not allowed:
            raise InputError(type(self).__name__, name, expected, str(getattr(self, name)))


# Neo-Hookean law: a thin sheet of incompressible rubber


@dataclass(frozen=True)
class NeoHookean(MembraneLaw):
    """Neo-Hookean membrane, W = (I1 - 1 + 1/(I2 + 1)) / 2.

    The sheet keeps its volume: it thins where its area grows. It softens at large strain and has no parameter other
    than G_s; K_s = 3 G_s. Codes that use the Young modulus E_s = 3 G_s have capillary numbers three times smaller.

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


# Skalak's law: a sheet that hardens with strain and may resist area dilation more than shear


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
        self._check("hardening", -0.5 < self.hardening < math.inf, "a finite number above -0.5")
        self._check("hardening", self.hardening <= _STIFFEST, f"a number of at most {_STIFFEST:g}")

    @property
    def name(self) -> str:
        return f"Skalak C = {_shown(self.hardening)}"

    @property
    def area_dilation_modulus(self) -> float:
        return 1.0 + 2.0 * self.hardening

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        c = self.hardening
        return (
            0.25 * (i1**2 + 2.0 * i1 - 2.0 * i2 + c * i2**2),
            0.5 * (i1 + 1.0),
            0.5 * (c * i2 - 1.0),
            np.full_like(i1, 0.5),
            np.zeros_like(i1),
            np.full_like(i1, 0.5 * c),
        )


# Generalised Hooke's law: linear elasticity of a thin sheet, for large displacements by Green's strain


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
        self._check("poisson_ratio", -1.0 < self.poisson_ratio < 1.0, "a number between -1 and 1")

    @property
    def name(self) -> str:
        return f"generalised Hooke nu_s = {_shown(self.poisson_ratio)}"

    @property
    def area_dilation_modulus(self) -> float:
        return (1.0 + self.poisson_ratio) / (1.0 - self.poisson_ratio)

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        curvature = 0.5 / (1.0 - self.poisson_ratio)
        return (
            0.5 * (curvature * i1**2 + i1 - i2),
            curvature * i1 + 0.5,
            np.full_like(i1, -0.5),
            np.full_like(i1, curvature),
            np.zeros_like(i1),
            np.zeros_like(i1),
        )


# A law between the neo-Hookean and generalised Hooke's: stiffer in extension, softer in compression

_RUBBER, _HOOKE = NeoHookean(), GeneralisedHooke(poisson_ratio=0.5)


@dataclass(frozen=True)
class HookeShare(MembraneLaw):
    """Mixture of a share s of generalised Hooke's energy with nu_s = 1/2 and the neo-Hookean: (1 - s) W_NH + s W_H."""

    # Both have K_s = 3 G_s, so that the share changes nothing at small strain. Barthes-Biesel, Diaz & Dhenin, J. Fluid
    # Mech. 460 (2002) 211-222, compare the two laws.

    hooke_share: float = 0.0
    area_dilation_modulus: ClassVar[float] = 3.0

    def __post_init__(self) -> None:
        self._check("hooke_share", 0.0 <= self.hooke_share <= 1.0, "a number from 0 to 1")

    @property
    def name(self) -> str:
        if self.hooke_share in (0.0, 1.0):
            return (_HOOKE if self.hooke_share else _RUBBER).name
        return f"{_RUBBER.name} with a share {_shown(self.hooke_share)} of {_HOOKE.name}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        return mixed(self.hooke_share, _RUBBER.derivatives(i1, i2), _HOOKE.derivatives(i1, i2))


# A law between the neo-Hookean and Skalak's: rubber that hardens with strain

_HARDENING = Skalak(hardening=1.0)


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
        self._check("strain_hardening", 0.0 <= self.strain_hardening <= 1.0, "a number from 0 to 1")

    @property
    def name(self) -> str:
        if self.strain_hardening == 0.0:
            return _RUBBER.name
        return f"{_RUBBER.name} with strain hardening h = {_shown(self.strain_hardening)}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        return mixed(self.strain_hardening, _RUBBER.derivatives(i1, i2), _HARDENING.derivatives(i1, i2))


# The law of Evans and Skalak: shear at constant area and change of area store their energies apart


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
        allowed = 0.0 < self.area_dilation_modulus <= _STIFFEST
        self._check("area_dilation_modulus", allowed, f"a positive number of at most {_STIFFEST:g}")

    @property
    def name(self) -> str:
        return f"Evans-Skalak K_s/G_s = {_shown(self.area_dilation_modulus)}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
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


# A family of laws with the area dilation modulus and the hardening free: from rubber to Skalak's law

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
        allowed = 1.0 <= self.area_dilation_modulus <= _LARGEST
        self._check("area_dilation_modulus", allowed, f"a number from 1 to {_LARGEST:g}")
        self._check("strain_hardening", 0.0 <= self.strain_hardening <= 1.0, "a number from 0 to 1")

    @property
    def name(self) -> str:
        return f"general K_s/G_s = {_shown(self.area_dilation_modulus)}, h = {_shown(self.strain_hardening)}"

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
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


LAWS: dict[str, type[MembraneLaw]] = {
    "neo-hookean": NeoHookean,
    "skalak": Skalak,
    "hooke": GeneralisedHooke,
    "strain-hardening": StrainHardening,
    "hooke-share": HookeShare,
    "general": GeneralLaw,
    "evans-skalak": EvansSkalak,
}
"""Every law of the library by the name used on the command line; each is checked by the tests."""


def law_named(text: str) -> MembraneLaw:
    """Return a law from its text form, ``name`` or ``name:parameter=value,...``.

    Parameters
    ----------
    text : str
        A name of `LAWS`, with the parameters that differ from their defaults.

    Raises
    ------
    InputError
        If there is no such law or parameter, or the value is not a number or out of range.

    Examples
    --------
    >>> law_named("skalak:hardening=10").name
    'Skalak C = 10'
    """
    name, _, rest = text.partition(":")
    try:
        values = {key: float(value) for key, _, value in (item.partition("=") for item in rest.split(",") if rest)}
        return LAWS[name](**values)
    except (KeyError, TypeError, ValueError):  # no such law, no such parameter, not a number
        raise InputError("law", "", f"one of {', '.join(map(_form, LAWS))}", repr(text)) from None


def _form(name: str) -> str:
    """Return the text form of a law with every parameter at its default."""
    parameters = ",".join(f"{field.name}={field.default}" for field in fields(LAWS[name]))
    return f"{name}:{parameters}" if parameters else name
