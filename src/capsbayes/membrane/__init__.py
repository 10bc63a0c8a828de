"""Membrane laws: elastic energy and tensions of a thin sheet, over its surface shear modulus G_s."""

from __future__ import annotations

from capsbayes.membrane.law import MembraneLaw
from capsbayes.membrane.neo_hookean import NeoHookean

__all__ = ["MembraneLaw", "NeoHookean"]
