"""All cases of one size ratio, one after the other, each from a converged neighbour.

A steady state costs little when it starts from a near one. A column is walked
from a middle capillary number outward: first upward, until no steady state
exists any more, then downward. The walk is a fixed program of runs whose
outcomes are kept, so a walk that was cut off takes up its thread by walking
again over what is kept, and ends with the same numbers as an undisturbed one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from capsbayes.simulation.parts import Outcome, Parts
from capsbayes.status import Status

__all__ = [
    "LIMIT_OF_DATABASE",
    "LIMIT_OF_EXISTENCE",
    "OUTLINE_POINTS",
    "Border",
    "Runs",
    "SteadySimulator",
    "limit_of_existence",
    "walk",
]

LIMIT_OF_EXISTENCE = "limit of existence"
LIMIT_OF_DATABASE = "limit of the database"

OUTLINE_POINTS = 256
_FIRST_CAPILLARY_NUMBER = 0.05
_LIMIT_TOLERANCE = 0.01  # relative, of the capillary number at the limit of existence
_FAILURES_DOWNWARD = 2  # in a row, after which the lower cases are not tried


class SteadySimulator(Protocol):
    """What the walk needs of a simulator."""

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers."""

    def run(self, *, capillary_number: float, size_ratio: float, start: Any = None) -> Any:
        """Steady state of one case."""


class Border(NamedTuple):
    """Upper end of a column: largest capillary number with a steady state, and what ends it there."""

    size_ratio: float
    capillary_number: float
    kind: str


@dataclass(frozen=True)
class Runs:
    """The runs of one column: from the kept outcome if there is one, else by the simulator."""

    simulator: SteadySimulator
    parts: Parts
    size_ratio: float
    final: dict[float, Outcome] = field(default_factory=dict)

    def __call__(self, capillary_number: float, start: Outcome | None) -> Outcome:
        """End of one case started from another's steady state; never raises for the case's sake."""
        origin = None if start is None else start.capillary_number
        outcome = self.parts.find(capillary_number, self.size_ratio, origin)
        if outcome is None:
            outcome = self._computed(capillary_number, start, origin)
            self.parts.save(outcome)
        self.final[capillary_number] = outcome
        return outcome

    def skip(self, capillary_number: float, start: Outcome | None, status: Status) -> None:
        """Give a case its status without running it."""
        origin = None if start is None else start.capillary_number
        outcome = self.parts.find(capillary_number, self.size_ratio, origin)
        if outcome is None:
            outcome = Outcome(capillary_number, self.size_ratio, origin, status)
            self.parts.save(outcome)
        self.final[capillary_number] = outcome

    def _computed(self, capillary_number: float, start: Outcome | None, origin: float | None) -> Outcome:
        try:
            state = self.simulator.run(
                capillary_number=capillary_number,
                size_ratio=self.size_ratio,
                start=None if start is None else start.state,
            )
            row = _row(state)
        except Exception as error:  # the other cases go on; this one says that it broke off
            message = f"{type(error).__name__}: {error}"
            return Outcome(capillary_number, self.size_ratio, origin, Status.RAISED, message=message)
        kept = state if state.status is Status.DONE else None
        return Outcome(capillary_number, self.size_ratio, origin, state.status, row, kept)


def walk(run: Runs, capillary_numbers: list[float]) -> Border | None:
    """Run every case of a column; the outcomes are then in ``run.final``.

    Parameters
    ----------
    run : Runs
    capillary_numbers : list of float
        The column's cases [-].

    Returns
    -------
    Border or None
        None when not one case converged.
    """
    ordered = sorted(capillary_numbers)
    first = _first_converged(run, ordered)
    if first is None:
        return None
    border = _upward(run, first, [value for value in ordered if value > first.capillary_number])
    _downward(run, first, [value for value in reversed(ordered) if value < first.capillary_number])
    return border


def limit_of_existence(
    run: Callable[[float, Outcome | None], Outcome],
    below: Outcome,
    above: Outcome,
    *,
    tolerance: float = _LIMIT_TOLERANCE,
) -> tuple[Outcome, Outcome]:
    """Narrow the limit of existence between two cases by bisection.

    Parameters
    ----------
    run : callable
        Outcome of a capillary number started from an outcome.
    below, above : Outcome
        A case that converged and a higher one that did not.
    tolerance : float
        Relative distance at which to stop.

    Returns
    -------
    below, above : Outcome
        The same, at most `tolerance` apart.
    """
    while above.capillary_number > (1.0 + tolerance) * below.capillary_number:
        middle = float(f"{np.sqrt(below.capillary_number * above.capillary_number):.6g}")
        outcome = run(middle, below)
        if outcome.done:
            below = outcome
        else:
            above = outcome
    return below, above


def _first_converged(run: Runs, ordered: list[float]) -> Outcome | None:
    by_distance = sorted(ordered, key=lambda value: (abs(np.log(value / _FIRST_CAPILLARY_NUMBER)), value))
    return next((outcome for outcome in (run(value, None) for value in by_distance) if outcome.done), None)


def _upward(run: Runs, first: Outcome, values: list[float]) -> Border:
    last = first
    for position, value in enumerate(values):
        outcome = run(value, last)
        if not outcome.done and outcome.status is not Status.RAISED:
            last, above = limit_of_existence(run, last, outcome)
            if above is outcome:  # everything below it converged: it may only have been too far a step
                outcome = above = run(value, last)
            if not outcome.done:
                _give_up_above(run, last, above, values[position + 1 :])
                kind = LIMIT_OF_EXISTENCE if above.status is Status.NO_STEADY_STATE else LIMIT_OF_DATABASE
                return Border(run.size_ratio, last.capillary_number, kind)
        if outcome.done:
            last = outcome
    return Border(run.size_ratio, last.capillary_number, LIMIT_OF_DATABASE)


def _give_up_above(run: Runs, last: Outcome, above: Outcome, values: list[float]) -> None:
    """Cases above the limit share its reason, where that is a reason for all that lies above."""
    lasting = above.status in (Status.NO_STEADY_STATE, Status.UNRESOLVED)
    for value in values:
        run.skip(value, last, above.status if lasting else Status.NOT_TRIED)


def _downward(run: Runs, first: Outcome, values: list[float]) -> None:
    last, failures = first, 0
    for value in values:
        if failures == _FAILURES_DOWNWARD:
            run.skip(value, last, Status.NOT_TRIED)
            continue
        outcome = run(value, last)
        failures = 0 if outcome.done else failures + 1
        last = outcome if outcome.done else last


def _row(state: Any) -> dict[str, Any]:
    """The case's variables; a shape that did not converge is not kept."""
    row: dict[str, Any] = {
        "residual": float(state.residual),
        "slack": float(state.slack),
        "iterations": int(state.iterations),
    }
    if state.status is not Status.DONE:
        return row
    profile = state.profile
    return row | {
        "axial_extent": profile.axial_extent,
        "axial_length": profile.axial_length,
        "parachute_depth": profile.parachute_depth,
        "perimeter": profile.perimeter,
        "stretch_ratio": profile.stretch_ratio(state.size_ratio),
        "velocity_ratio": float(state.velocity_ratio),
        "inner_pressure": float(state.inner_pressure),
        "extra_pressure_drop": float(state.extra_pressure_drop),
        "minimum_tension": float(np.min(state.principal_tensions)),
        "nodes": np.array(state.nodes, dtype=float),
        "profile": np.array(profile.resampled(OUTLINE_POINTS).points),
        "silhouette": np.array(state.silhouette.resampled(OUTLINE_POINTS).points),
    }
