"""The capsule that the paper identified in an experiment."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from capsbayes.evidence.verification.references import BOUNDARY_INTEGRAL, PAPER
from capsbayes.evidence.verification.row import Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.evidence.verification.states import QUANTITIES, SYMBOLS, numbers, steady
from capsbayes.physics.continuation.branches import SLACK_LIMIT
from capsbayes.physics.simulation.simulator import Simulator

__all__ = ["section"]

_CASE = (0.082, 0.96)
_TARGETS = {"axial_extent": 0.005, "axial_length": 0.005, "velocity_ratio": 0.001}


def section() -> Section:
    """Lengths and velocity at two refinements."""
    return Section(
        "paper-capsule",
        "The capsule of the paper",
        "Ca = {:g}, a/l = {:g}, neo-Hookean, square channel. The paper's numbers come from a picture.".format(*_CASE),
        {_item(n): partial(_state, n) for n in (8, 12)},
        _rows,
    )


def _item(refinement: int) -> str:
    return f"n = {refinement}"


def _state(refinement: int) -> Values:
    return numbers(steady(Simulator(refinement=refinement), *_CASE))


def _rows(results: Results) -> Iterator[Row]:
    for refinement in (8, 12):
        for quantity in QUANTITIES:
            ours = results.value(_item(refinement), quantity)
            words = f"{SYMBOLS[quantity]}, n = {refinement}"
            yield Row(words, ours, PAPER.at(_CASE, quantity), Target("relative", 0.01))
            finest = BOUNDARY_INTEGRAL.at(16, quantity)
            finest = finest._replace(source=f"{finest.source}, n = 16")
            yield Row(words, ours, finest, Target("relative", _TARGETS[quantity]))
            if refinement == 8:
                same = BOUNDARY_INTEGRAL.at(8, quantity)
                yield Row(words, ours, same._replace(source=f"{same.source}, n = 8"))
        yield Row(
            f"slack, n = {refinement}", results.value(_item(refinement), "slack"), target=Target("at most", SLACK_LIMIT)
        )
