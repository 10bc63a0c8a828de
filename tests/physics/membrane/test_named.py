"""Laws by their text form, in the library and on the command line."""

from __future__ import annotations

import inspect

import pytest

from capsbayes.cli.simulating import build, simulate
from capsbayes.errors import InputError
from capsbayes.physics.membrane import LAWS, EvansSkalak, GeneralisedHooke, GeneralLaw, NeoHookean, Skalak, law_named


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


def test_a_value_out_of_range_is_told_the_range():
    with pytest.raises(InputError, match=r"poisson_ratio: expected a number between -1 and 1, got 2\.0$"):
        law_named("hooke:poisson_ratio=2")


@pytest.mark.parametrize("share", ["-0.1", "1.1"])
def test_a_share_of_hardening_beyond_one_of_the_two_laws_is_refused(share):
    with pytest.raises(InputError, match=rf"strain_hardening: expected a number from 0 to 1, got {share}$"):
        law_named(f"strain-hardening:strain_hardening={share}")


@pytest.mark.parametrize("command", [simulate, build])
def test_the_help_of_a_command_names_every_law(command):
    option = inspect.signature(command, eval_str=True).parameters["law"]
    told = option.annotation.__metadata__[0].help
    assert all(name in told for name in LAWS)
    assert law_named(option.default) == NeoHookean()
