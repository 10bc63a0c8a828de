"""The law of Evans and Skalak against its closed forms."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsbayes.errors import InputError
from capsbayes.physics.membrane import EvansSkalak

stretches = st.floats(min_value=0.5, max_value=3.0)
moduli = st.floats(min_value=0.1, max_value=100.0)


@given(stretches, stretches, moduli)
def test_tensions_are_those_of_area_and_of_shear(l1, l2, modulus):
    """A mean tension K (J - 1), and a difference (l1^2 - l2^2) / J^2 that depends on the shear alone up to 1/J."""
    area = l1 * l2
    mean, half = modulus * (area - 1), (l1**2 - l2**2) / (2 * area**2)
    assert EvansSkalak(modulus).principal_tensions([l1, l2]) == pytest.approx([mean + half, mean - half], abs=1e-10)


@given(stretches, stretches, moduli)
def test_energy_is_the_sum_of_both(l1, l2, modulus):
    energy = EvansSkalak(modulus).energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    expected = modulus * (l1 * l2 - 1) ** 2 / 2 + (l1 / l2 + l2 / l1) / 2 - 1
    assert energy == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_it_is_named_by_its_modulus():
    assert EvansSkalak(2.5).name == "Evans-Skalak K_s/G_s = 2.5"


@pytest.mark.parametrize("modulus", [0.0, -1.0, float("nan"), float("inf"), 1.1e6])
def test_a_sheet_without_resistance_to_area_or_without_an_area_that_changes_is_refused(modulus):
    with pytest.raises(InputError, match=r"^EvansSkalak: area_dilation_modulus: expected a positive number of at most"):
        EvansSkalak(modulus)
