"""Membrane laws: elastic energy and tensions of a thin sheet, over its surface shear modulus G_s."""

from __future__ import annotations

from capsbayes.membrane.law import MembraneLaw
from capsbayes.membrane.neo_hookean import NeoHookean

__all__ = ["LAWS", "MembraneLaw", "NeoHookean"]

LAWS: dict[str, type[MembraneLaw]] = {"neo-hookean": NeoHookean}
"""Every law of the library by the name used on the command line; each is checked by the tests."""
