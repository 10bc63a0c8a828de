"""The neo-Hookean law against its closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsbayes.physics.membrane import NeoHookean

stretches = st.floats(min_value=0.5, max_value=3.0)


@given(stretches, stretches)
def test_energy_is_that_of_an_incompressible_sheet_of_rubber(l1, l2):
    """With l3 = 1/(l1 l2) and G_s = G h, W = (l1^2 + l2^2 + l3^2 - 3) / 2."""
    energy = NeoHookean().energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    assert energy == pytest.approx((l1**2 + l2**2 + (l1 * l2) ** -2 - 3) / 2, rel=1e-12, abs=1e-13)


@given(stretches, stretches)
def test_tensions_follow_the_closed_form(l1, l2):
    """tau_1 = [l1^2 - 1/(l1 l2)^2] / (l1 l2), as printed in the literature of capsules."""
    tension = NeoHookean().principal_tensions([l1, l2])
    area = l1 * l2
    np.testing.assert_allclose(tension, [(l1**2 - area**-2) / area, (l2**2 - area**-2) / area], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("alpha", [0.01, 0.05, 0.3])
def test_isotropic_tension_of_an_inflated_sphere(alpha):
    stretch = 1.0 + alpha
    np.testing.assert_allclose(NeoHookean().principal_tensions([stretch, stretch]), 1.0 - stretch**-6, rtol=1e-13)


def test_a_sheet_free_across_contracts_by_a_half_of_the_elongation():
    """tau_2 = 0 holds where l2 = l1^(-1/2): Poisson ratio 1/2 of rubber."""
    tension = NeoHookean().principal_tensions([1.44, 1.44**-0.5])
    assert tension[1] == pytest.approx(0.0, abs=1e-15)
    assert tension[0] > 0.5


def test_batches_keep_their_shape():
    law = NeoHookean()
    assert law.principal_tensions(np.ones((4, 3, 2))).shape == (4, 3, 2)
    assert law.energy(np.zeros((4, 1)), np.zeros(3)).shape == (4, 3)


def test_is_frozen_equal_and_named():
    law = NeoHookean()
    assert law == NeoHookean()
    assert law.name == "neo-Hookean"
    assert law.area_dilation_modulus == 3.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        law.name = "other"
