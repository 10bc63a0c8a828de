"""Skalak's law against its closed forms."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsbayes.errors import InputError
from capsbayes.physics.membrane import NeoHookean, Skalak

stretches = st.floats(min_value=0.5, max_value=3.0)
hardenings = st.floats(min_value=-0.4, max_value=100.0)


@given(stretches, stretches, hardenings)
def test_tensions_follow_the_closed_form(l1, l2, c):
    """tau_1 = (l1/l2) [l1^2 - 1 + C l2^2 ((l1 l2)^2 - 1)], as printed in the literature of capsules."""
    areal = c * ((l1 * l2) ** 2 - 1)
    expected = [l1 / l2 * (l1**2 - 1 + l2**2 * areal), l2 / l1 * (l2**2 - 1 + l1**2 * areal)]
    assert Skalak(c).principal_tensions([l1, l2]) == pytest.approx(expected, rel=1e-11, abs=1e-11)


@given(stretches, stretches, hardenings)
def test_energy_is_that_of_the_green_strains_and_of_the_area(l1, l2, c):
    """W = e1^2 + e2^2 + C ((l1 l2)^2 - 1)^2 / 4 with e = (l^2 - 1) / 2."""
    energy = Skalak(c).energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    expected = ((l1**2 - 1) ** 2 + (l2**2 - 1) ** 2 + c * ((l1 * l2) ** 2 - 1) ** 2) / 4
    assert energy == pytest.approx(expected, rel=1e-11, abs=1e-11)


@given(st.floats(1.05, 3.0))
def test_hardens_where_the_neo_hookean_law_of_the_same_moduli_softens(stretch):
    """At C = 1 both have K_s = 3 G_s; tau - 6 (l - 1) then has opposite signs, 6 (l - 1) being the linear tension."""
    linear = 6 * (stretch - 1)
    assert Skalak(1.0).principal_tensions([stretch, stretch])[0] > linear
    assert NeoHookean().principal_tensions([stretch, stretch])[0] < linear


@pytest.mark.parametrize(("c", "modulus", "name"), [(1, 3, "Skalak C = 1"), (0.1, 1.2, "Skalak C = 0.1")])
def test_its_parameter_sets_the_area_dilation_modulus_and_is_named(c, modulus, name):
    assert Skalak(c).area_dilation_modulus == pytest.approx(modulus, rel=1e-15)
    assert Skalak(c).name == name


@pytest.mark.parametrize("c", [-0.5, float("nan"), float("inf")])
def test_a_sheet_without_resistance_to_area_is_refused(c):
    with pytest.raises(InputError, match=rf"^Skalak: hardening: expected a finite number above -0.5, got {c}$"):
        Skalak(c)


def test_a_sheet_whose_area_cannot_change_in_double_precision_is_refused():
    assert Skalak(1e6).area_dilation_modulus == 2_000_001.0
    with pytest.raises(InputError, match=r"^Skalak: hardening: expected a number of at most 1e\+06, got 1100000\.0$"):
        Skalak(1.1e6)
