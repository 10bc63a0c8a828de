"""Membrane laws: what holds for each, their closed forms, how they contain each other, their names and text forms."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from capsbayes import Simulator
from capsbayes.cli.simulating import build, simulate
from capsbayes.errors import InputError
from capsbayes.physics.membrane import (
    LAWS,
    EvansSkalak,
    GeneralisedHooke,
    GeneralLaw,
    HookeShare,
    NeoHookean,
    Skalak,
    StrainHardening,
    law_named,
)
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.testing import check_law

stretches, moderate, shares = st.floats(0.5, 3.0), st.floats(0.6, 1.6), st.floats(0.0, 1.0)

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


def rubber(l1, l2, m):
    """Energy of a Blatz-Ko sheet, with the limit K = 1 in its own form; m = 1 is incompressible rubber."""
    j2 = (l1 * l2) ** 2
    return (l1**2 + l2**2 - 2 + (-np.log(j2) if m == 0 else np.expm1(-m * np.log(j2)) / m)) / 2


def rubber_tension(l1, l2, m):
    return (l1**2 - (l1 * l2) ** (-2 * m)) / (l1 * l2)


def skalak(l1, l2, c):
    """W = e1^2 + e2^2 + C ((l1 l2)^2 - 1)^2 / 4 with e = (l^2 - 1) / 2."""
    return ((l1**2 - 1) ** 2 + (l2**2 - 1) ** 2 + c * ((l1 * l2) ** 2 - 1) ** 2) / 4


def skalak_tension(l1, l2, c):
    return l1 / l2 * (l1**2 - 1 + c * l2**2 * ((l1 * l2) ** 2 - 1))


class Form(NamedTuple):
    """Closed forms, as printed in the literature of capsules, of the energy and of tau_1, with their tolerances."""

    law: Callable  # of two numbers from 0 to 1
    energy: Callable  # of the law and the stretches
    tension: Callable
    of_energy: dict
    of_tension: dict


LOOSE = {"rel": 1e-11, "abs": 1e-11}
FORMS = {
    "neo-hookean": Form(
        lambda p, q: NeoHookean(),
        lambda law, l1, l2: (l1**2 + l2**2 + (l1 * l2) ** -2 - 3) / 2,
        lambda law, l1, l2: rubber_tension(l1, l2, 1),
        {"rel": 1e-12, "abs": 1e-13},
        {"rel": 1e-11, "abs": 1e-12},
    ),
    "skalak": Form(
        lambda p, q: Skalak(-0.4 + 100.4 * p**4),
        lambda law, l1, l2: skalak(l1, l2, law.hardening),
        lambda law, l1, l2: skalak_tension(l1, l2, law.hardening),
        *(LOOSE, LOOSE),
    ),
    "hooke": Form(
        lambda p, q: GeneralisedHooke(-0.9 + 1.85 * p),
        lambda law, l1, l2: (
            skalak(l1, l2, 0) + law.poisson_ratio / (1 - law.poisson_ratio) * (l1**2 + l2**2 - 2) ** 2 / 4
        ),
        lambda law, l1, l2: l1 / l2 * (l1**2 - 1 + law.poisson_ratio * (l2**2 - 1)) / (1 - law.poisson_ratio),
        *(LOOSE, LOOSE),
    ),
    "evans-skalak": Form(
        lambda p, q: EvansSkalak(0.1 + 99.9 * p**4),
        lambda law, l1, l2: law.area_dilation_modulus * (l1 * l2 - 1) ** 2 / 2 + (l1 / l2 + l2 / l1) / 2 - 1,
        lambda law, l1, l2: law.area_dilation_modulus * (l1 * l2 - 1) + (l1**2 - l2**2) / (2 * (l1 * l2) ** 2),
        *(LOOSE, {"abs": 1e-10}),
    ),
    "general": Form(
        lambda p, q: GeneralLaw(1.0 + 4.0 * p, q),
        lambda law, l1, l2: mixed(law, rubber, skalak, l1, l2),
        lambda law, l1, l2: mixed(law, rubber_tension, skalak_tension, l1, l2),
        *(LOOSE, LOOSE),
    ),
}


def mixed(law, soft, hard, l1, l2):
    m, h = (law.area_dilation_modulus - 1) / 2, law.strain_hardening
    return (1 - h) * soft(l1, l2, m) + h * hard(l1, l2, m)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@given(stretches, stretches, shares, shares)
def test_energy_and_tensions_are_those_of_the_closed_form(form, l1, l2, p, q):
    law = form.law(p, q)
    energy = law.energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    assert energy == pytest.approx(form.energy(law, l1, l2), **form.of_energy)
    tensions = [form.tension(law, l1, l2), form.tension(law, l2, l1)]
    assert law.principal_tensions([l1, l2]) == pytest.approx(tensions, **form.of_tension)


@pytest.mark.parametrize(
    ("member", "law"),
    [
        (GeneralLaw(3.0, 0.0), NeoHookean()),
        *((GeneralLaw(1 + 2 * c, 1.0), Skalak(c)) for c in (0.0, 0.3, 10.0)),
        (StrainHardening(0.0), NeoHookean()),
        (StrainHardening(1.0), Skalak(1.0)),
        (HookeShare(0.0), NeoHookean()),
        (HookeShare(1.0), GeneralisedHooke(0.5)),
        (GeneralisedHooke(0.0), Skalak(0.0)),
    ],
    ids=lambda law: repr(law),
)
@given(moderate, moderate)
def test_a_member_of_a_family_is_that_law_to_rounding(member, law, l1, l2):
    i1, i2 = np.array(l1**2 + l2**2 - 2), np.array((l1 * l2) ** 2 - 1)
    for ours, theirs in zip(member.derivatives(i1, i2), law.derivatives(i1, i2), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-13, abs=1e-13)


@given(st.floats(1.05, 3.0))
def test_skalak_hardens_where_the_neo_hookean_law_of_the_same_moduli_softens(stretch):
    """At C = 1 both have K_s = 3 G_s; tau - 6 (l - 1) then has opposite signs, 6 (l - 1) being the linear tension."""
    linear = 6 * (stretch - 1)
    assert Skalak(1.0).principal_tensions([stretch, stretch])[0] > linear
    assert NeoHookean().principal_tensions([stretch, stretch])[0] < linear


@given(st.floats(-1e-9, 1e-9), moderate, moderate, shares)
def test_nothing_cancels_near_equal_moduli(change, l1, l2, h):
    near, limit = GeneralLaw(1.0 + abs(change), h), GeneralLaw(1.0, h)
    invariants = l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1
    assert limit.energy(*invariants) == pytest.approx(mixed(limit, rubber, skalak, l1, l2), abs=1e-13)
    assert near.energy(*invariants) == pytest.approx(limit.energy(*invariants), abs=2e-8)
    assert near.principal_tensions([l1, l2]) == pytest.approx(limit.principal_tensions([l1, l2]), abs=2e-8)


@given(st.floats(1.0, 5.0), shares, shares, st.floats(1.05, 1.6), st.floats(1.05, 1.6))
def test_a_general_sheet_stretched_both_ways_is_in_tension_and_hardens_with_its_share(modulus, first, second, l1, l2):
    soft, hard = (GeneralLaw(modulus, h) for h in sorted([first, second]))
    assert np.min(soft.principal_tensions([l1, l2])) > 0
    assert soft.principal_tensions([l1, l1])[0] <= hard.principal_tensions([l1, l1])[0] + 1e-12


def test_generalised_hooke_is_no_member_of_the_general_laws():
    """At stretches from 1 to 1.4, over its largest tension; it is one at nu_s = 0 only."""
    stretch = np.stack(np.meshgrid(*[np.linspace(1.0, 1.4, 9)] * 2), axis=-1).reshape(-1, 2)

    def nearest(hooke):
        tensions = hooke.principal_tensions(stretch)
        laws = [GeneralLaw(hooke.area_dilation_modulus, h) for h in np.linspace(0.0, 1.0, 41)]
        return min(np.max(np.abs(law.principal_tensions(stretch) - tensions)) for law in laws) / np.max(tensions)

    assert nearest(GeneralisedHooke(0.0)) < 1e-12
    assert 0.1 < nearest(GeneralisedHooke(0.5)) < 0.5


def test_batches_keep_their_shape():
    law = NeoHookean()
    assert law.principal_tensions(np.ones((4, 3, 2))).shape == (4, 3, 2)
    assert law.energy(np.zeros((4, 1)), np.zeros(3)).shape == (4, 3)


@pytest.mark.parametrize(
    ("law", "modulus", "name"),
    [
        (NeoHookean(), 3.0, "neo-Hookean"),
        (Skalak(1), 3.0, "Skalak C = 1"),
        (Skalak(0.1), 1.2, "Skalak C = 0.1"),
        (Skalak(1e6), 2_000_001.0, "Skalak C = 1000000"),
        (GeneralisedHooke(0.5), 3.0, "generalised Hooke nu_s = 0.5"),
        (GeneralisedHooke(-0.5), 1 / 3, "generalised Hooke nu_s = -0.5"),
        (HookeShare(0.0), 3.0, "neo-Hookean"),
        (HookeShare(0.25), 3.0, "neo-Hookean with a share 0.25 of generalised Hooke nu_s = 0.5"),
        (HookeShare(1.0), 3.0, "generalised Hooke nu_s = 0.5"),
        (StrainHardening(0.0), 3.0, "neo-Hookean"),
        (StrainHardening(0.25), 3.0, "neo-Hookean with strain hardening h = 0.25"),
        (GeneralLaw(2.0, 0.4), 2.0, "general K_s/G_s = 2, h = 0.4"),
        (EvansSkalak(2.5), 2.5, "Evans-Skalak K_s/G_s = 2.5"),
    ],
)
def test_parameters_set_the_area_dilation_modulus_and_the_name(law, modulus, name):
    assert law.area_dilation_modulus == pytest.approx(modulus, rel=1e-15)
    assert law.name == name


@pytest.mark.parametrize(
    ("text", "law"),
    [
        ("neo-hookean", NeoHookean()),
        ("skalak", Skalak()),
        ("skalak:hardening=10", Skalak(10.0)),
        ("hooke:poisson_ratio=-.25", GeneralisedHooke(-0.25)),
        ("evans-skalak:area_dilation_modulus=2", EvansSkalak(2.0)),
        ("general:area_dilation_modulus=2,strain_hardening=.25", GeneralLaw(2.0, 0.25)),
    ],
)
def test_a_name_and_its_parameters_give_the_law(text, law):
    assert law_named(text) == law


@pytest.mark.parametrize(
    "text",
    ["rubber", "", "Skalak", "skalak:C=1", "skalak:hardening", "skalak:hardening=soft", "neo-hookean:hardening=1"],
)
def test_a_mistake_is_told_what_there_is(text):
    with pytest.raises(InputError) as caught:
        law_named(text)
    forms = (
        "neo-hookean, skalak:hardening=1.0, hooke:poisson_ratio=0.5, strain-hardening:strain_hardening=0.0, "
        "hooke-share:hooke_share=0.0, general:area_dilation_modulus=3.0,strain_hardening=0.0, "
        "evans-skalak:area_dilation_modulus=3.0"
    )
    assert str(caught.value) == f"law: expected one of {forms}, got {text!r}"


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("skalak:hardening", (-0.5, "nan", "inf"), "Skalak: hardening: expected a finite number above -0.5"),
        ("skalak:hardening", (1.1e6,), "Skalak: hardening: expected a number of at most 1e+06"),
        ("hooke:poisson_ratio", (-1.0, 1.0, 2.0, "nan"), "poisson_ratio: expected a number between -1 and 1"),
        ("hooke-share:hooke_share", (-0.1, 1.5), "HookeShare: hooke_share: expected a number from 0 to 1"),
        ("strain-hardening:strain_hardening", (-0.1, 1.1), "strain_hardening: expected a number from 0 to 1"),
        (
            "evans-skalak:area_dilation_modulus",
            (0.0, -1.0, "nan", "inf", 1.1e6),
            "EvansSkalak: area_dilation_modulus: expected a positive number of at most 1e+06",
        ),
        (
            "general:area_dilation_modulus",
            (0.9, "nan", 1000.0),
            "GeneralLaw: area_dilation_modulus: expected a number from 1 to 100",
        ),
        ("general:strain_hardening", (-0.1,), "GeneralLaw: strain_hardening: expected a number from 0 to 1"),
    ],
)
def test_parameters_out_of_range_are_refused(name, values, expected):
    for value in values:
        with pytest.raises(InputError) as caught:
            law_named(f"{name}={value}")
        assert str(caught.value).endswith(f"{expected}, got {value}")


@pytest.mark.parametrize("command", [simulate, build])
def test_the_help_of_a_command_names_every_law(command):
    option = inspect.signature(command, eval_str=True).parameters["law"]
    told = option.annotation.__metadata__[0].help
    assert all(name in told for name in LAWS)
    assert law_named(option.default) == NeoHookean()


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
