"""The channels by the names of their cross-sections."""

from __future__ import annotations

from capsbayes.errors import InputError
from capsbayes.physics.stokes.channel import Channel
from capsbayes.physics.stokes.circular import CircularChannel
from capsbayes.physics.stokes.rectangular import RectangularChannel, SquareChannel
from capsbayes.physics.stokes.rounded_square import RoundedSquareChannel

_NAMES = (SquareChannel.name, RectangularChannel.name, CircularChannel.name)


def cross_section_named(name: str, corner_radius: float = 0.0, aspect: float = 1.0) -> Channel:
    """Return the channel ``"square"``, ``"rectangular"`` or ``"circular"``; refuse another name."""
    # `corner_radius` [l] of a square; `aspect`: depth along the direction of view over the width seen, b / l.
    if name not in _NAMES:
        raise InputError("cross_section", "", f"one of {', '.join(_NAMES)}", repr(name))
    if corner_radius != 0.0 and (name != SquareChannel.name or aspect != 1.0):
        expected = "0, or a square cross-section of equal sides"
        raise InputError("cross_section", "corner_radius", expected, f"{corner_radius:g}")
    if name == CircularChannel.name:
        if aspect != 1.0:
            raise InputError("cross_section", "section_aspect", "1 for a circular cross-section", f"{aspect:g}")
        return CircularChannel()
    if corner_radius != 0.0:
        return RoundedSquareChannel(corner_radius)
    return SquareChannel() if name == SquareChannel.name and aspect == 1.0 else RectangularChannel(aspect)
