"""Undisturbed flow of every section."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from capsbayes.evidence.verification.references import FRICTION, UNDISTURBED
from capsbayes.evidence.verification.row import Reference, Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.physics.stokes.channel import Channel
from capsbayes.physics.stokes.circular import CircularChannel
from capsbayes.physics.stokes.rectangular import RectangularChannel, SquareChannel
from capsbayes.physics.stokes.rounded_square import RoundedSquareChannel

__all__ = ["section"]

_CLASSICAL: dict[str, Channel] = {"square": SquareChannel(), "circular": CircularChannel()}
_RADII = (0.01, 0.05, 0.1, 0.2)
_WORDS = {"centre_velocity": "velocity at the centre", "pressure_gradient": "pressure gradient"}


def section() -> Section:
    """Centre velocity and pressure gradient, and the corners' radius to zero."""
    channels = (
        _CLASSICAL
        | {_rectangle(aspect): RectangularChannel(aspect) for aspect in FRICTION.numbers}
        | {_rounded(radius): RoundedSquareChannel(radius) for radius in _RADII}
    )
    return Section(
        "undisturbed-flow",
        "Undisturbed flow",
        "Over U, and over mu U/l^2. Rounded corners of radius r_c take only the order (r_c^2 log r_c)^2 from the flux: "
        "for small r_c both fall below those of the square as the area does, by the share (1 - pi/4) r_c^2; the "
        "target is twice that order.",
        {name: partial(_flow, channel) for name, channel in channels.items()},
        _rows,
    )


def _rectangle(aspect: float) -> str:
    return f"rectangle b/l = {aspect:g}"


def _rounded(radius: float) -> str:
    return f"rounded r_c/l = {radius:g}"


def _flow(channel: Channel) -> Values:
    centre = channel.undisturbed(np.zeros((1, 3)))[0][0, 2]
    return {"centre_velocity": float(centre), "pressure_gradient": channel.pressure_gradient}


def _rows(results: Results) -> Iterator[Row]:
    for name in _CLASSICAL:
        for quantity, words in _WORDS.items():
            reference = UNDISTURBED.at(name, quantity)
            yield Row(f"{name}: {words}", results.value(name, quantity), reference, Target("relative", 1e-7))
    for aspect in FRICTION.numbers:
        diameter = 4.0 * aspect / (1.0 + aspect)
        factor = results.value(_rectangle(aspect), "pressure_gradient") * diameter**2 / 2.0
        reference = FRICTION.at(aspect, "friction_factor")
        yield Row(f"{_rectangle(aspect)}: f Re", factor, reference, Target("relative", 1e-4))
    for quantity, words in _WORDS.items():
        yield from _to_the_square(results, quantity, words)


def _to_the_square(results: Results, quantity: str, words: str) -> Iterator[Row]:
    square, share = UNDISTURBED.at("square", quantity).value, 1.0 - np.pi / 4.0
    values = results.across(map(_rounded, _RADII), quantity)
    for radius, value in zip(_RADII, values, strict=True):
        reference = Reference(square * (1.0 - share * radius**2), "square, area law")
        target = Target("relative", 2.0 * (radius**2 * np.log(radius)) ** 2)
        yield Row(f"{_rounded(radius)}: {words}", float(value), reference, target)
    coefficient = float(1.0 - values[0] / square) / _RADII[0] ** 2
    words = f"{_rounded(_RADII[0])}: loss of {words} over r_c^2"
    yield Row(words, coefficient, Reference(share, "area law"), Target("relative", 0.01))
