"""Convergence of a capsule with the mesh, and what it costs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from capsbayes.evidence.verification.rates import fitted_limit, fitted_rate
from capsbayes.evidence.verification.row import Reference, Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.evidence.verification.states import QUANTITIES, SYMBOLS, numbers, steady
from capsbayes.physics.simulation.simulator import Simulator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["section"]

_CASE, _NEIGHBOUR = (0.05, 0.9), (0.04, 0.9)
_REFINEMENTS = (6, 8, 10, 12, 16)
_ITEMS = [f"n = {n}" for n in _REFINEMENTS]
_TARGETS = {  # errors at n = 8 and at n = 12
    "axial_extent": (0.005, 0.002),
    "axial_length": (0.005, 0.002),
    "velocity_ratio": (0.001, 0.0005),
}


def section() -> Section:
    """Errors and processor times on five meshes."""
    return Section(
        "refinement",
        "Refinement",
        "Neo-Hookean capsule at Ca = {:g}, a/l = {:g} in the square channel. Values on all meshes are fitted by "
        "q + c n^-p; q is the reference of the errors. Times are those of Newton's method from the steady state at "
        "Ca = {:g}, the shorter of two.".format(*_CASE, _NEIGHBOUR[0]),
        dict(zip(_ITEMS, (partial(_state, n) for n in _REFINEMENTS), strict=True)),
        _rows,
        _picture,
    )


def _state(refinement: int) -> Values:
    simulator = Simulator(refinement=refinement)
    neighbour = steady(simulator, *_NEIGHBOUR)
    seconds = []
    for _ in range(2):
        begin = time.process_time()
        state = steady(simulator, *_CASE, neighbour)
        seconds.append(time.process_time() - begin)
    return numbers(state) | {"seconds": min(seconds), "iterations": state.iterations}


def _rows(results: Results) -> Iterator[Row]:
    for quantity in QUANTITIES:
        values, symbol = results.across(_ITEMS, quantity), SYMBOLS[quantity]
        limit = fitted_limit(_REFINEMENTS, values)
        reference = Reference(limit.value, "fitted limit")
        targets = dict(zip((8, 12), _TARGETS[quantity], strict=True))
        for n, value in zip(_REFINEMENTS, values, strict=True):
            target = Target("relative", targets[n]) if n in targets else None
            yield Row(f"{symbol}, n = {n}", float(value), reference, target)
        yield Row(f"{symbol}: fitted rate p", limit.rate, target=Target("at least", 2.0))
    seconds = results.across(_ITEMS, "seconds")
    for n, duration in zip(_REFINEMENTS, seconds, strict=True):
        yield Row(f"seconds of a steady state from its neighbour, n = {n}", float(duration))
    yield Row("fitted exponent of the time in n", -fitted_rate(_REFINEMENTS, seconds))


def _picture(results: Results, figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    for quantity in QUANTITIES:
        values = results.across(_ITEMS, quantity)
        limit = fitted_limit(_REFINEMENTS, values)
        label = f"${SYMBOLS[quantity]}$, $p = {limit.rate:.1f}$"
        left.loglog(_REFINEMENTS, np.abs(values / limit.value - 1.0), "o-", label=label)
    left.set_ylabel("relative error")
    seconds = results.across(_ITEMS, "seconds")
    right.loglog(_REFINEMENTS, seconds, "o-", label=f"exponent {-fitted_rate(_REFINEMENTS, seconds):.1f}")
    right.set_ylabel("seconds")
    for axes in (left, right):
        axes.set(xlabel="refinement $n$", xticks=_REFINEMENTS, xticklabels=map(str, _REFINEMENTS))
        axes.minorticks_off()
        axes.legend()
