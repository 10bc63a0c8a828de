"""All cases of one size ratio, one after the other, each from a converged neighbour.

A steady state costs little when it starts from a near one. A column is walked
upward from the lowest capillary number, along the branch of a capsule at rest.
Where that branch ends or becomes unstable a capsule snaps through to a
parachute, and the walk goes on along the parachutes until they end too. Then
the shapes below are confirmed from rest, from the top down. The walk is a fixed
program of runs whose outcomes are kept, so a walk that was cut off takes up its
thread by walking again over what is kept, and ends with the same numbers as an
undisturbed one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from capsbayes.physics.simulation.outcome import Outcome
from capsbayes.physics.simulation.settling import SHALLOW
from capsbayes.status import Status
from capsbayes.work import Store

__all__ = [
    "LIMIT_OF_DATABASE",
    "LIMIT_OF_EXISTENCE",
    "LOST",
    "OUTLINE_POINTS",
    "SNAP_THROUGH",
    "Border",
    "Runs",
    "SteadySimulator",
    "walk",
]

LIMIT_OF_EXISTENCE = "limit of existence"
LIMIT_OF_DATABASE = "limit of the database"

SNAP_THROUGH = "snap-through"
LOST = "lost from rest"

OUTLINE_POINTS = 256
_FIRST_TRIED = (0.01, 0.02, 0.05)  # where to begin if the lowest case does not converge
_BELOW_LIMIT = (0.96, 0.99)  # of the Ca at which a branch ends: cases that are run beside those asked for
_FALL = 0.015  # share of L_z that is lost in a snap-through, and not from one parachute to the next
_BRACKET = 1.08  # of the Ca on either side of a snap-through
_SAME = 2e-3  # difference of L_z below which two shapes are one
_FAILURES_DOWNWARD = 2  # in a row, after which the lower cases are not tried


class SteadySimulator(Protocol):
    """What the walk needs of a simulator."""

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers."""

    def run(self, *, capillary_number: float, size_ratio: float, start: Any = "rest") -> Any:
        """Return the steady state of one case."""

    def restored(self, values: Mapping[str, Any]) -> Any:
        """Return the steady state whose fields have these values."""


Start = Outcome | Literal["rest", "parachute"]


class Border(NamedTuple):
    """End of a branch in a column: the capillary number there, and what ends it.

    `kind` is LIMIT_OF_EXISTENCE or LIMIT_OF_DATABASE at the upper end of the column. Below it, where the shapes that a
    capsule at rest begins with end, it is SNAP_THROUGH: up to there a parachute may be stable as well. Where a
    capsule beyond it was not seen to come to rest, it is LOST: which shape it takes from there on is not established.
    """

    size_ratio: float
    capillary_number: float
    kind: str


@dataclass(frozen=True)
class Runs:
    """The runs of one column: from the kept outcome if there is one, else by the simulator.

    A case is started from another's outcome or, see `Simulator.run`, from ``"rest"`` or from a ``"parachute"``.
    """

    simulator: SteadySimulator
    store: Store
    size_ratio: float
    final: dict[float, Outcome] = field(default_factory=dict)

    def __call__(self, capillary_number: float, start: Start) -> Outcome:
        """End of one case started from another's steady state; never raises for the case's sake."""
        origin = start if isinstance(start, str) else start.capillary_number
        outcome = self._kept(capillary_number, origin)
        if outcome is None:
            outcome = self._computed(capillary_number, start, origin)
            outcome.save(self.store)
        self.final[capillary_number] = outcome
        return outcome

    def skip(self, capillary_number: float, start: Outcome, status: Status) -> None:
        """Give a case its status without running it."""
        origin = start.capillary_number
        outcome = self._kept(capillary_number, origin)
        if outcome is None:
            outcome = Outcome(capillary_number, self.size_ratio, origin, status)
            outcome.save(self.store)
        self.final[capillary_number] = outcome

    def _kept(self, capillary_number: float, origin: float | str) -> Outcome | None:
        return Outcome.find(self.store, capillary_number, self.size_ratio, origin, self.simulator.restored)

    def _computed(self, capillary_number: float, start: Start, origin: float | str) -> Outcome:
        try:
            state = self.simulator.run(
                capillary_number=capillary_number,
                size_ratio=self.size_ratio,
                start=start if isinstance(start, str) else start.state,
            )
            row = _row(state)
        except Exception as error:  # the other cases go on; this one says that it broke off
            message = f"{type(error).__name__}: {error}"
            return Outcome(capillary_number, self.size_ratio, origin, Status.RAISED, message=message)
        kept = state if state.status is Status.DONE else None
        return Outcome(capillary_number, self.size_ratio, origin, state.status, row, kept)


def walk(run: Runs, capillary_numbers: list[float]) -> list[Border]:
    """Run every case of a column, and some more at the ends of its branches; the outcomes are then in ``run.final``.

    Parameters
    ----------
    run : Runs
    capillary_numbers : list of float
        The column's cases [-].

    Returns
    -------
    list of Border
        Empty when not one case converged.
    """
    ordered = sorted(capillary_numbers)
    first = _first_converged(run, ordered)
    if first is None:
        return []
    borders = _upward(run, first, [value for value in ordered if value > first.capillary_number])
    _downward(run, first, [value for value in reversed(ordered) if value < first.capillary_number])
    return borders


def _first_converged(run: Runs, ordered: list[float]) -> Outcome | None:
    nearest = [min(ordered, key=lambda value: abs(np.log(value / tried))) for tried in _FIRST_TRIED]
    candidates = dict.fromkeys([ordered[0], *nearest, *ordered])
    return next((outcome for outcome in (run(value, "rest") for value in candidates) if outcome.done), None)


def _upward(run: Runs, first: Outcome, values: list[float]) -> list[Border]:
    last, climbed, lost = first, [first], []
    upper = None
    for position, value in enumerate(values):
        outcome = run(value, last)
        if outcome.status is Status.RAISED:
            continue
        if not outcome.done:
            limit = _limit(outcome, last)
            beyond = None if _deep(last) else _elsewhere(run, value)
            if beyond is None:
                run.final[value] = outcome
                _approach(run, last, limit)
                kind = LIMIT_OF_EXISTENCE if outcome.status is Status.NO_STEADY_STATE else LIMIT_OF_DATABASE
                upper = Border(run.size_ratio, limit, kind)
                _give_up_above(run, last, outcome, values[position + 1 :])
                break
            if beyond.start == "parachute":
                lost = [Border(run.size_ratio, limit, LOST)]
            outcome = beyond
        if not _deep(last):
            climbed.append(outcome)
        last = outcome
    end = upper or Border(run.size_ratio, last.capillary_number, LIMIT_OF_DATABASE)
    return [*(lost or _snap_through(run, _confirmed(run, climbed))), end]


def _elsewhere(run: Runs, value: float) -> Outcome | None:
    """Where a capsule is whose branch has ended: where it comes to from rest, or a parachute."""
    starts: tuple[Start, ...] = ("rest", "parachute")
    return next((outcome for outcome in (run(value, start) for start in starts) if outcome.done), None)


def _confirmed(run: Runs, climbed: list[Outcome]) -> list[Outcome]:
    """The cases up to the first parachute, each the one that a capsule from rest comes to.

    What is reached from rest at one Ca on the branch is on it at all lower ones: the search goes downward.
    """
    confirmed = list(climbed)
    for place, outcome in reversed(list(enumerate(climbed))):
        if _deep(outcome):
            continue
        if outcome.start == "rest":
            break
        reached = run(outcome.capillary_number, "rest")
        if not reached.done:
            run.final[outcome.capillary_number] = outcome
            continue
        confirmed[place] = reached
        if abs(reached.variables["axial_extent"] / outcome.variables["axial_extent"] - 1.0) < _SAME:
            break
    return confirmed


def _snap_through(run: Runs, cases: list[Outcome]) -> list[Border]:
    """Enclose the Ca at which a capsule snaps through; none if the shape changes smoothly."""
    last, beyond = next((pair for pair in pairwise(cases) if _fallen(*pair)), (None, None))
    if last is None or beyond is None:
        return []
    while beyond.capillary_number > _BRACKET * last.capillary_number:
        between = run(_rounded((last.capillary_number * beyond.capillary_number) ** 0.5), "rest")
        if not between.done:
            break
        last, beyond = (last, between) if _fallen(last, between) else (between, beyond)
    return [Border(run.size_ratio, _rounded((last.capillary_number * beyond.capillary_number) ** 0.5), SNAP_THROUGH)]


def _fallen(last: Outcome, outcome: Outcome) -> bool:
    """Whether the capsule has become so much shorter as a parachute is that came from a convex shape."""
    return outcome.done and outcome.variables["axial_extent"] < (1.0 - _FALL) * last.variables["axial_extent"]


def _deep(outcome: Outcome) -> bool:
    """Whether the rear is so concave that the capsule does not snap through any more."""
    return bool(outcome.variables["parachute_depth"] > SHALLOW * outcome.size_ratio)


def _limit(outcome: Outcome, last: Outcome) -> float:
    """Ca at which the branch of `last` ended on the way to a case, as far as it is known."""
    limit = float(outcome.variables.get("limit", np.nan))
    return limit if limit > last.capillary_number else last.capillary_number


def _approach(run: Runs, last: Outcome, limit: float) -> None:
    """Run cases between the last converged one and the end of its branch."""
    for share in _BELOW_LIMIT:
        value = _rounded(share * limit)
        if value > 1.01 * last.capillary_number:
            outcome = run(value, last)
            last = outcome if outcome.done else last


def _rounded(capillary_number: float) -> float:
    return float(f"{capillary_number:.4g}")


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
        "limit": float(state.limit),
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
        "wrinkling_rate": float(state.wrinkling_rate),
        "minimum_tension": float(np.min(state.principal_tensions)),
        "nodes": np.array(state.nodes, dtype=float),
        "profile": np.array(profile.resampled(OUTLINE_POINTS).points),
        "silhouette": np.array(state.silhouette.resampled(OUTLINE_POINTS).points),
    }
