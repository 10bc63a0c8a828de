"""Membrane laws: elastic energy and tensions of a thin sheet, over its surface shear modulus G_s."""

from __future__ import annotations

from dataclasses import fields

from capsbayes.errors import InputError
from capsbayes.physics.membrane.evans_skalak import EvansSkalak
from capsbayes.physics.membrane.general import GeneralLaw
from capsbayes.physics.membrane.hooke import GeneralisedHooke
from capsbayes.physics.membrane.hooke_share import HookeShare
from capsbayes.physics.membrane.law import MembraneLaw
from capsbayes.physics.membrane.neo_hookean import NeoHookean
from capsbayes.physics.membrane.skalak import Skalak
from capsbayes.physics.membrane.strain_hardening import StrainHardening

__all__ = [
    "LAWS",
    "EvansSkalak",
    "GeneralLaw",
    "GeneralisedHooke",
    "HookeShare",
    "MembraneLaw",
    "NeoHookean",
    "Skalak",
    "StrainHardening",
    "law_named",
]

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

    Returns
    -------
    MembraneLaw

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
