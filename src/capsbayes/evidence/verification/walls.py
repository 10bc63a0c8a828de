"""The discretisation of the walls: spacing of the Stokeslets and length of the channel."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from capsbayes.evidence.verification.row import Reference, Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.evidence.verification.states import QUANTITIES, SYMBOLS, numbers, steady
from capsbayes.physics.simulation.simulator import Simulator
from capsbayes.physics.stokes.walls import WallDiscretisation

__all__ = ["section"]

_CASE = (0.082, 0.96)
_AS_SHIPPED, _SHIPPED = "as shipped", WallDiscretisation()
_OTHERS = {
    "finer spacing": WallDiscretisation(spacing=0.065, far_spacing=0.13),
    "coarser spacing": WallDiscretisation(spacing=0.1),
    "longer channel": WallDiscretisation(end=4.0),
}


def section(refinement: int = 6) -> Section:
    """One capsule with other walls."""
    return Section(
        "walls",
        "Walls",
        "Ca = {:g}, a/l = {:g} at refinement {}, with other representations of the walls.".format(*_CASE, refinement),
        {name: partial(_state, walls, refinement) for name, walls in ({_AS_SHIPPED: _SHIPPED} | _OTHERS).items()},
        _rows,
    )


def _state(walls: WallDiscretisation, refinement: int) -> Values:
    return numbers(steady(Simulator(refinement=refinement, walls=walls), *_CASE))


def _rows(results: Results) -> Iterator[Row]:
    for name, walls in _OTHERS.items():
        for quantity in QUANTITIES:
            reference = Reference(
                results.value(_AS_SHIPPED, quantity), f"spacing {_SHIPPED.spacing:g} l, half length {_SHIPPED.end:g} l"
            )
            words = f"{name}: {SYMBOLS[quantity]}, spacing {walls.spacing:g} l, half length {walls.end:g} l"
            yield Row(words, results.value(name, quantity), reference, Target("relative", 2e-4))
