"""The general law against its members, its closed form in the stretches and its moduli."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from capsbayes import Simulator
from capsbayes.errors import InputError
from capsbayes.physics.membrane import GeneralisedHooke, GeneralLaw, NeoHookean, Skalak
from capsbayes.physics.stokes import WallDiscretisation

stretches = st.floats(0.6, 1.6)
moduli = st.floats(1.0, 5.0)
shares = st.floats(0.0, 1.0)
TIGHT = {"xatol": 1e-9}
general_laws = st.builds(GeneralLaw, moduli, shares)


def energy(law, l1, l2):
    """W in the stretches, with the limit K = 1 in its own form."""
    m, h, j2 = (law.area_dilation_modulus - 1) / 2, law.strain_hardening, (l1 * l2) ** 2
    areal = -np.log(j2) if m == 0 else np.expm1(-m * np.log(j2)) / m
    rubber = (l1**2 + l2**2 - 2 + areal) / 2
    return (1 - h) * rubber + h * ((l1**2 - 1) ** 2 + (l2**2 - 1) ** 2 + m * (j2 - 1) ** 2) / 4


def slope(function, at, step=1e-3):
    """Derivative by differences of fourth order."""
    near, far = function(at + step) - function(at - step), function(at + 2 * step) - function(at - 2 * step)
    return (8 * near - far) / (12 * step)


@given(stretches, stretches, st.floats(0.0, 10.0))
def test_neo_hookean_and_skalak_are_members_to_rounding(l1, l2, c):
    i1, i2 = np.array(l1**2 + l2**2 - 2), np.array((l1 * l2) ** 2 - 1)
    for member, law in ((GeneralLaw(3.0, 0.0), NeoHookean()), (GeneralLaw(1 + 2 * c, 1.0), Skalak(c))):
        for ours, theirs in zip(member.derivatives(i1, i2), law.derivatives(i1, i2), strict=True):
            assert ours == pytest.approx(theirs, rel=1e-13, abs=1e-13)


@given(general_laws)
def test_moduli_at_small_strain_are_those_it_names(law):
    """K_s = d tau / d ln(area) in equal stretch; G_s = d(tau_1 - tau_2) / d(4 e) in pure shear."""
    areal = slope(lambda e: law.principal_tensions([np.exp(e / 2)] * 2)[0], 0.0)
    shear = slope(lambda e: np.subtract(*law.principal_tensions(np.exp([e, -e]))) / 4, 0.0)
    assert areal == pytest.approx(law.area_dilation_modulus, abs=1e-8)
    assert shear == pytest.approx(1.0, abs=1e-8)


@given(general_laws, st.floats(0.7, 1.5))
def test_tensions_are_slopes_of_the_energy(law, stretch):
    """Equal stretch: dW/dl / (2 l). One way: the slope of the smallest energy over the free stretch across."""
    biaxial = slope(lambda both: energy(law, both, both), stretch) / (2 * stretch)
    assert law.principal_tensions([stretch, stretch]) == pytest.approx([biaxial] * 2, abs=1e-7)

    def relaxed(l1):
        return minimize_scalar(lambda l2: energy(law, l1, l2), bounds=(0.4, 2.0), method="bounded", options=TIGHT)

    across = relaxed(stretch).x
    uniaxial = slope(lambda l1: relaxed(l1).fun, stretch) / across
    assert law.principal_tensions([stretch, across]) == pytest.approx([uniaxial, 0.0], abs=1e-5)


@given(st.floats(-1e-9, 1e-9), stretches, stretches, shares)
def test_nothing_cancels_near_equal_moduli(change, l1, l2, h):
    near, limit = GeneralLaw(1.0 + abs(change), h), GeneralLaw(1.0, h)
    invariants = l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1
    assert limit.energy(*invariants) == pytest.approx(energy(limit, l1, l2), abs=1e-13)
    assert near.energy(*invariants) == pytest.approx(limit.energy(*invariants), abs=2e-8)
    assert near.principal_tensions([l1, l2]) == pytest.approx(limit.principal_tensions([l1, l2]), abs=2e-8)


@given(general_laws, st.floats(1.001, 1.6), st.floats(1.001, 1.6))
def test_a_sheet_stretched_both_ways_is_in_tension(law, l1, l2):
    assert np.min(law.principal_tensions([l1, l2])) > 0


@given(moduli, shares, shares, st.floats(1.05, 1.6))
def test_a_larger_share_hardens(modulus, first, second, stretch):
    soft, hard = (GeneralLaw(modulus, h).principal_tensions([stretch] * 2)[0] for h in sorted([first, second]))
    assert soft <= hard + 1e-12


def test_generalised_hooke_is_no_member():
    """At stretches from 1 to 1.4, over its largest tension; it is one at nu_s = 0 only."""
    stretch = np.stack(np.meshgrid(*[np.linspace(1.0, 1.4, 9)] * 2), axis=-1).reshape(-1, 2)

    def nearest(hooke):
        tensions = hooke.principal_tensions(stretch)
        laws = [GeneralLaw(hooke.area_dilation_modulus, h) for h in np.linspace(0.0, 1.0, 41)]
        return min(np.max(np.abs(law.principal_tensions(stretch) - tensions)) for law in laws) / np.max(tensions)

    assert nearest(GeneralisedHooke(0.0)) < 1e-12
    assert 0.1 < nearest(GeneralisedHooke(0.5)) < 0.5


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ((0.9, 0.0), "area_dilation_modulus: expected a number from 1 to 100, got 0.9"),
        ((float("nan"), 0.0), "area_dilation_modulus: expected a number from 1 to 100, got nan"),
        ((1e3, 0.0), "area_dilation_modulus: expected a number from 1 to 100, got 1000.0"),
        ((3.0, -0.1), "strain_hardening: expected a number from 0 to 1, got -0.1"),
    ],
)
def test_parameters_out_of_range_are_refused(parameters, message):
    with pytest.raises(InputError) as caught:
        GeneralLaw(*parameters)
    assert str(caught.value) == f"GeneralLaw: {message}"


@pytest.mark.slow
@pytest.mark.parametrize(("member", "law"), [(GeneralLaw(), NeoHookean()), (GeneralLaw(3.0, 1.0), Skalak(1.0))])
def test_members_have_the_same_steady_shape(member, law):
    """In a square channel at Ca = 0.05, a/l = 0.8."""
    walls = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)
    ours, theirs = (
        Simulator(law=one, refinement=4, walls=walls).run(capillary_number=0.05, size_ratio=0.8)
        for one in (member, law)
    )
    assert ours.status.ok
    np.testing.assert_allclose(ours.nodes, theirs.nodes, atol=1e-8)
    assert ours.velocity_ratio == pytest.approx(theirs.velocity_ratio, abs=1e-8)
