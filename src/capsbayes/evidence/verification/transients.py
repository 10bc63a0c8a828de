"""A capsule from rest to its steady state by time steps, compared with Newton's method."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from capsbayes.evidence.verification.quantities import QUANTITIES, SYMBOLS, numbers, steady
from capsbayes.evidence.verification.topic import Reference, Results, Row, Target, Topic, Values
from capsbayes.physics.load import profile
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.transient import STEADY, Scheme, transient

_CASE, _NEIGHBOUR = (0.12, 0.9), (0.11, 0.9)
_SETTLED = 2.4  # U t/l by which the paper finds the capsule steady
_TIMES = (*np.linspace(0.2, _SETTLED, 12).round(1).tolist(), 50.0)
_NEWTON, _IMPLICIT, _EXPLICIT = "Newton's method", "semi-implicit steps", "explicit steps"


def transients(refinement: int = 6) -> Topic:
    """Return the topic of Newton's method and both schemes on one mesh."""
    return Topic(
        "transients",
        "Transients",
        "Neo-Hookean capsule at Ca = {:g}, a/l = {:g} in the square channel, from rest, at refinement {}. The "
        "semi-implicit steps end when no node moves faster than {:g} U relative to the centroid, the explicit ones "
        "at ten times that; Newton's method starts from the steady state at Ca = {:g}.".format(
            *_CASE, refinement, STEADY, _NEIGHBOUR[0]
        ),
        {
            _NEWTON: partial(_newton, refinement),
            _IMPLICIT: partial(_followed, refinement, "semi-implicit", STEADY),
            _EXPLICIT: partial(_followed, refinement, "explicit", 10.0 * STEADY),
        },
        _rows,
        _picture,
    )


def _newton(refinement: int) -> Values:
    simulator = Simulator(refinement=refinement)
    neighbour = steady(simulator, *_NEIGHBOUR)
    begin = time.process_time()
    state = steady(simulator, *_CASE, neighbour)
    return numbers(state) | {"seconds": time.process_time() - begin}


def _followed(refinement: int, scheme: Scheme, speed: float) -> Values:
    """Return series over the times."""
    problem = Simulator(refinement=refinement).problem
    begin = time.process_time()
    times, found = [], []
    for instant in transient(problem, problem.at_rest(*_CASE), _TIMES, scheme=scheme, steady=speed):
        outline = profile(problem.mesh, problem.mesh.expanded(instant.iterate.free))
        times.append(instant.time)
        found.append([outline.axial_extent, outline.axial_length, instant.iterate.velocity])
    seconds = time.process_time() - begin
    series: dict[str, float | list[float]] = dict(zip(QUANTITIES, np.array(found).T.tolist(), strict=True))
    return series | {"seconds": seconds, "times": times}


def _rows(results: Results) -> Iterator[Row]:
    for scheme, bound in ((_IMPLICIT, 5e-4), (_EXPLICIT, 2e-3)):
        for quantity in QUANTITIES:
            end = Reference(results.value(_NEWTON, quantity), _NEWTON)
            words = f"{scheme}: {SYMBOLS[quantity]} at the end"
            yield Row(words, results.value(scheme, quantity), end, Target("relative", bound))
    for when in (0.2, 0.6, _SETTLED):
        for quantity in QUANTITIES:
            reference = Reference(_at(results, _EXPLICIT, quantity, when), _EXPLICIT)
            words = f"{_IMPLICIT}: {SYMBOLS[quantity]} at U t/l = {when:g}"
            yield Row(words, _at(results, _IMPLICIT, quantity, when), reference, Target("relative", 2e-3))
    for quantity, when, bound in (("velocity_ratio", 1.6, 1e-3), ("axial_extent", _SETTLED, 1e-2)):
        after = results.series(_IMPLICIT, "times") >= when - 1e-9
        difference = np.abs(results.series(_IMPLICIT, quantity) / results.value(_NEWTON, quantity) - 1.0)
        largest = float(np.max(difference[after])) if np.any(after) else np.nan
        words = f"{SYMBOLS[quantity]}: largest relative difference from {_NEWTON} after U t/l = {when:g}"
        yield Row(words, largest, target=Target("at most", bound))
    seconds = {item: results.value(item, "seconds") for item in (_NEWTON, _IMPLICIT, _EXPLICIT)}
    for item, duration in seconds.items():
        yield Row(f"{item}: seconds", duration)
    for item in (_IMPLICIT, _EXPLICIT):
        yield Row(f"{item}: times as long as {_NEWTON}", seconds[item] / seconds[_NEWTON])


def _at(results: Results, item: str, quantity: str, when: float) -> float:
    """Return a quantity at one of the times, NaN where it was not reached."""
    at = np.isclose(results.series(item, "times"), when)
    return float(results.series(item, quantity)[at][0]) if np.any(at) else float("nan")


def _picture(results: Results, figure: Figure) -> None:
    for axes, quantity in zip(figure.subplots(1, len(QUANTITIES)), QUANTITIES, strict=True):
        for item, style in ((_IMPLICIT, "-"), (_EXPLICIT, "o")):
            axes.plot(results.series(item, "times"), results.series(item, quantity), style, label=item)
        axes.axhline(results.value(_NEWTON, quantity), color="0.6", linewidth=0.8, label=_NEWTON)
        axes.set(xlabel=r"$Ut/\ell$", ylabel=f"${SYMBOLS[quantity]}$")
    axes.legend()
