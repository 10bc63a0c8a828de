"""Generalised Hooke's law against its closed forms."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsbayes.errors import InputError
from capsbayes.physics.membrane import GeneralisedHooke, Skalak

stretches = st.floats(min_value=0.5, max_value=3.0)
poisson_ratios = st.floats(min_value=-0.9, max_value=0.95)


@given(stretches, stretches, poisson_ratios)
def test_tensions_follow_the_closed_form(l1, l2, nu):
    """tau_1 = (l1/l2) [l1^2 - 1 + nu_s (l2^2 - 1)] / (1 - nu_s), as printed in the literature of capsules."""
    e1, e2 = l1**2 - 1, l2**2 - 1
    expected = [l1 / l2 * (e1 + nu * e2) / (1 - nu), l2 / l1 * (e2 + nu * e1) / (1 - nu)]
    assert GeneralisedHooke(nu).principal_tensions([l1, l2]) == pytest.approx(expected, rel=1e-11, abs=1e-11)


@given(stretches, stretches, poisson_ratios)
def test_energy_is_quadratic_in_the_green_strains(l1, l2, nu):
    """W = e1^2 + e2^2 + nu_s / (1 - nu_s) (e1 + e2)^2 with e = (l^2 - 1) / 2."""
    e1, e2 = (l1**2 - 1) / 2, (l2**2 - 1) / 2
    energy = GeneralisedHooke(nu).energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    assert energy == pytest.approx(e1**2 + e2**2 + nu / (1 - nu) * (e1 + e2) ** 2, rel=1e-11, abs=1e-11)


@given(st.floats(1.0, 1.4), poisson_ratios)
def test_a_sheet_free_across_contracts_by_the_poisson_ratio(stretch, nu):
    """tau_2 = 0 holds at any strain where e2 = -nu_s e1."""
    across = (1 - nu * (stretch**2 - 1)) ** 0.5
    assert GeneralisedHooke(nu).principal_tensions([stretch, across])[1] == pytest.approx(0.0, abs=1e-12)


@given(stretches, stretches)
def test_without_a_poisson_ratio_it_is_skalaks_law_without_area_term(l1, l2):
    tension = GeneralisedHooke(0.0).principal_tensions([l1, l2])
    assert tension == pytest.approx(Skalak(0.0).principal_tensions([l1, l2]), rel=1e-13, abs=1e-13)


@pytest.mark.parametrize(("nu", "modulus", "name"), [(0.5, 3, "nu_s = 0.5"), (-0.5, 1 / 3, "nu_s = -0.5")])
def test_its_parameter_sets_the_area_dilation_modulus_and_is_named(nu, modulus, name):
    assert GeneralisedHooke(nu).area_dilation_modulus == pytest.approx(modulus, rel=1e-15)
    assert GeneralisedHooke(nu).name == f"generalised Hooke {name}"


@pytest.mark.parametrize("nu", [-1, 1, float("nan")])
def test_a_poisson_ratio_out_of_range_is_refused(nu):
    with pytest.raises(InputError, match=rf"^GeneralisedHooke: poisson_ratio: expected .* -1 and 1, got {nu}$"):
        GeneralisedHooke(nu)
