"""The sections of channels by their names."""

from __future__ import annotations

from capsbayes.errors import InputError
from capsbayes.physics.stokes.channel import Channel
from capsbayes.physics.stokes.circular import CircularChannel
from capsbayes.physics.stokes.rectangular import RectangularChannel
from capsbayes.physics.stokes.rounded_square import RoundedSquareChannel
from capsbayes.physics.stokes.square import SquareChannel

__all__ = ["SECTIONS", "section_named"]

SECTIONS = (SquareChannel.name, RectangularChannel.name, CircularChannel.name)


def section_named(name: str, corner_radius: float = 0.0, aspect: float = 1.0) -> Channel:
    """The channel with the section called `name`.

    Parameters
    ----------
    name : str
        One of `SECTIONS`.
    corner_radius : float
        Radius of the corners of a square over l [-].
    aspect : float
        Depth along the direction of view over the width seen, b / l, of a rectangle, or of a square that is not quite
        one [-].

    Raises
    ------
    InputError
        If there is no such section.

    Examples
    --------
    >>> section_named("square", corner_radius=0.1)
    RoundedSquareChannel(corner_radius=0.1)
    """
    if name not in SECTIONS:
        raise InputError("section", "", f"one of {', '.join(SECTIONS)}", repr(name))
    if corner_radius != 0.0 and (name != SquareChannel.name or aspect != 1.0):
        raise InputError("section", "corner_radius", "0, or a square section of equal sides", f"{corner_radius:g}")
    if name == CircularChannel.name:
        if aspect != 1.0:
            raise InputError("section", "section_aspect", "1 for a circular section", f"{aspect:g}")
        return CircularChannel()
    if corner_radius != 0.0:
        return RoundedSquareChannel(corner_radius)
    return SquareChannel() if name == SquareChannel.name and aspect == 1.0 else RectangularChannel(aspect)
