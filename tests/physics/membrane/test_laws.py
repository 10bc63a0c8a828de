"""What holds for every law of the library, at several values of its parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from capsbayes.physics.membrane import LAWS, EvansSkalak, GeneralisedHooke, GeneralLaw, Skalak
from capsbayes.testing import check_law

OTHERS = [
    *map(Skalak, (0.0, 0.1, 10.0)),
    *map(GeneralisedHooke, (-0.5, 0.0, 0.8)),
    *map(EvansSkalak, (0.5, 10.0)),
    *(GeneralLaw(modulus, share) for modulus, share in ((1.0, 0.0), (1.0 + 1e-9, 0.3), (2.0, 0.7), (5.0, 0.5))),
]

every_law = pytest.mark.parametrize("law", [*(law() for law in LAWS.values()), *OTHERS], ids=lambda law: law.name)


@every_law
def test_keeps_every_promise(law):
    check_law(law)


@every_law
def test_a_law_is_frozen_and_its_name_tells_its_parameters(law):
    for parameter in dataclasses.fields(law):
        other = dataclasses.replace(law, **{parameter.name: getattr(law, parameter.name) + 1e-12})
        assert other != law
        assert other.name != law.name
    with pytest.raises(dataclasses.FrozenInstanceError):
        law.name = "other"


@every_law
@given(st.floats(0.7, 1.4), st.floats(0.7, 1.4))
def test_strain_costs_energy(law, l1, l2):
    energy = law.energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    strain = (l1 - 1) ** 2 + (l2 - 1) ** 2
    assert energy >= 0.1 * strain - 1e-12


@every_law
@given(st.floats(1.0, 1.4), st.floats(1.0, 1.4))
def test_larger_tension_lies_along_the_larger_stretch(law, l1, l2):
    """Not so in strong compression, where the laws made of Green's strain give way."""
    tension = law.principal_tensions(np.array([l1, l2]))
    assert (tension[0] - tension[1]) * (l1 - l2) >= -1e-14


@every_law
@given(st.floats(1e-3, 0.1))
def test_all_laws_agree_to_first_order_in_shear(law, strain):
    """At l1 = exp(e), l2 = exp(-e) the tensions differ by 4 e (1 + O(e^2)), over G_s."""
    tension = law.principal_tensions(np.exp([strain, -strain]))
    assert abs((tension[0] - tension[1]) / (4 * strain) - 1) <= 25 * strain**2


@every_law
@given(st.floats(1e-4, 1e-2))
def test_a_sheet_pulled_one_way_contracts_across_as_its_moduli_tell(law, strain):
    """At small strain e2 = -nu_s e1, nu_s = (K_s - G_s) / (K_s + G_s)."""
    across = brentq(lambda l2: law.principal_tensions([1 + strain, l2])[1], 0.95, 1.05, xtol=1e-14)
    poisson_ratio = (law.area_dilation_modulus - 1) / (law.area_dilation_modulus + 1)
    assert (1 - across) / strain == pytest.approx(poisson_ratio, abs=3 * strain)
