"""A sweep in Ca: all cases of one size ratio, one after the other, each from a converged neighbour.

A steady state costs little when it starts from a near one. The sweep goes upward from the lowest capillary number,
along the branch of a capsule at rest. Where that branch ends or becomes unstable a capsule snaps through to a
parachute, and the sweep goes on along the parachutes until they end too. Then the shapes below are confirmed from
rest, from the highest Ca downward. Each case depends only on the outcomes of earlier ones, which are stored: an
interrupted sweep repeats the same steps with the stored outcomes and ends with the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from capsbayes.database import LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE, LOST_FROM_REST, SNAP_THROUGH
from capsbayes.interruption import raise_interruption
from capsbayes.physics.continuation.settling import SHALLOW
from capsbayes.physics.databases.outcome import Outcome, name_of, variables_of
from capsbayes.status import Status
from capsbayes.work import Store, steps_kept

_FIRST_TRIED = (0.01, 0.02, 0.05)  # first Ca to try if the lowest case does not converge
_BELOW_LIMIT = (0.96, 0.99)  # of the Ca at which a branch ends: cases added to those asked for
_SNAPPED = 0.015  # share of L_z that is lost in a snap-through, and not from one parachute to the next
_BRACKET = 1.08  # largest ratio of the Ca on either side of a snap-through
_SAME = 2e-3  # relative difference of L_z below which two shapes are the same
_FAILURES_DOWNWARD = 2  # in a row, after which the lower cases are not tried


class SteadySimulator(Protocol):
    """Simulator of steady states, as a sweep needs it."""

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers, in types that JSON has."""

    def run(self, *, capillary_number: float, size_ratio: float, start: Any = "rest") -> Any:
        """Return the steady state of one case, a dataclass."""

    def restored(self, values: Mapping[str, Any]) -> Any:
        """Return the steady state whose fields have these values."""


Start = Outcome | Literal["rest", "parachute"]


class Border(NamedTuple):
    """End of a branch in a sweep: the capillary number there, and the kind of border (see `capsbayes.database`)."""

    size_ratio: float
    capillary_number: float
    kind: str


class Sweep(NamedTuple):
    """Outcomes of one size ratio in rising Ca, and the ends of its branches; none if no case converged."""

    outcomes: list[Outcome]
    borders: list[Border]


@dataclass(frozen=True)
class CaseRunner:
    """Runner of the cases of one size ratio: it takes them from the store, or computes them with the simulator."""

    simulator: SteadySimulator
    store: Store
    size_ratio: float
    final: dict[float, Outcome] = field(default_factory=dict)  # the last outcome of each case

    def run(self, capillary_number: float, start: Start) -> Outcome:
        """Return the outcome of one case; an error of the simulator is an outcome too."""
        origin = start if isinstance(start, str) else start.capillary_number
        outcome = self._stored(capillary_number, origin) or self._computed(capillary_number, start, origin)
        self.final[capillary_number] = outcome
        return outcome

    def skip(self, capillary_number: float, start: Outcome, status: Status) -> None:
        """Give a case a status without running it."""
        origin = start.capillary_number
        outcome = self._stored(capillary_number, origin)
        if outcome is None:
            outcome = Outcome(capillary_number, self.size_ratio, origin, status)
            outcome.save(self.store)
        self.final[capillary_number] = outcome

    def _stored(self, capillary_number: float, origin: float | str) -> Outcome | None:
        return Outcome.find(self.store, capillary_number, self.size_ratio, origin, self.simulator.restored)

    def _computed(self, capillary_number: float, start: Start, origin: float | str) -> Outcome:
        case = (capillary_number, self.size_ratio, origin)
        try:
            with steps_kept(self.store, name_of(*case)):
                state = self.simulator.run(
                    capillary_number=capillary_number,
                    size_ratio=self.size_ratio,
                    start=start if isinstance(start, str) else start.state,
                )
            kept = state if state.status is Status.DONE else None
            outcome = Outcome(*case, state.status, variables_of(state), kept)
        except Exception as error:  # the other cases go on; this one keeps the reason
            raise_interruption(error)
            outcome = Outcome(*case, Status.RAISED, message=f"{type(error).__name__}: {error}")
        outcome.save(self.store)
        return outcome


def sweep(runner: CaseRunner, capillary_numbers: list[float]) -> Sweep:
    """Run the cases of one size ratio at the capillary numbers asked for, and some more at the ends of its branches."""
    ordered = sorted(capillary_numbers)
    first = _first_converged(runner, ordered)
    borders: list[Border] = []
    if first is not None:
        borders = _upward(runner, first, [ca for ca in ordered if ca > first.capillary_number])
        _downward(runner, first, [ca for ca in reversed(ordered) if ca < first.capillary_number])
    return Sweep([runner.final[ca] for ca in sorted(runner.final)], borders)


def _first_converged(runner: CaseRunner, ordered: list[float]) -> Outcome | None:
    nearest = [min(ordered, key=lambda ca: abs(np.log(ca / tried))) for tried in _FIRST_TRIED]
    candidates = dict.fromkeys([ordered[0], *nearest, *ordered])
    return next((outcome for outcome in (runner.run(ca, "rest") for ca in candidates) if outcome.done), None)


def _upward(runner: CaseRunner, first: Outcome, capillary_numbers: list[float]) -> list[Border]:
    last, convex, lost = first, [first], []
    upper = None
    for position, ca in enumerate(capillary_numbers):
        outcome = runner.run(ca, last)
        if outcome.status is Status.RAISED:
            continue
        if not outcome.done:
            limit = _limit(outcome, last)
            beyond = None if _is_deep(last) else _beyond_branch(runner, ca)
            if beyond is None:
                runner.final[ca] = outcome
                _approach(runner, last, limit)
                kind = LIMIT_OF_EXISTENCE if outcome.status is Status.NO_STEADY_STATE else LIMIT_OF_DATABASE
                upper = Border(runner.size_ratio, limit, kind)
                _skip_above(runner, last, outcome, capillary_numbers[position + 1 :])
                break
            if beyond.start == "parachute":
                lost = [Border(runner.size_ratio, limit, LOST_FROM_REST)]
            outcome = beyond
        if not _is_deep(last):
            convex.append(outcome)
        last = outcome
    end = upper or Border(runner.size_ratio, last.capillary_number, LIMIT_OF_DATABASE)
    return [*(lost or _snap_through(runner, _confirmed(runner, convex))), end]


def _beyond_branch(runner: CaseRunner, capillary_number: float) -> Outcome | None:
    """Return the state of a capsule whose branch has ended: the one it reaches from rest, or a parachute."""
    starts: tuple[Start, ...] = ("rest", "parachute")
    outcomes = (runner.run(capillary_number, start) for start in starts)
    return next((outcome for outcome in outcomes if outcome.done), None)


def _confirmed(runner: CaseRunner, followed: list[Outcome]) -> list[Outcome]:
    """Return the cases up to the first parachute, each the one that a capsule reaches from rest."""
    # If the state reached from rest at one Ca is on the branch, so are those at all lower Ca: the search goes downward.
    confirmed = list(followed)
    for place, outcome in reversed(list(enumerate(followed))):
        if _is_deep(outcome):
            continue
        if outcome.start == "rest":
            break
        reached = runner.run(outcome.capillary_number, "rest")
        if not reached.done:
            runner.final[outcome.capillary_number] = outcome
            continue
        confirmed[place] = reached
        if abs(reached.variables["axial_extent"] / outcome.variables["axial_extent"] - 1.0) < _SAME:
            break
    return confirmed


def _snap_through(runner: CaseRunner, outcomes: list[Outcome]) -> list[Border]:
    """Enclose the Ca at which a capsule snaps through; no border if the shape changes smoothly."""
    last, beyond = next((pair for pair in pairwise(outcomes) if _has_snapped(*pair)), (None, None))
    if last is None or beyond is None:
        return []
    while beyond.capillary_number > _BRACKET * last.capillary_number:
        between = runner.run(_middle(last, beyond), "rest")
        if not between.done:
            break
        last, beyond = (last, between) if _has_snapped(last, between) else (between, beyond)
    return [Border(runner.size_ratio, _middle(last, beyond), SNAP_THROUGH)]


def _has_snapped(last: Outcome, outcome: Outcome) -> bool:
    """Return whether a capsule is so much shorter than the last one as a snap-through makes it."""
    return outcome.done and outcome.variables["axial_extent"] < (1.0 - _SNAPPED) * last.variables["axial_extent"]


def _is_deep(outcome: Outcome) -> bool:
    """Return whether the rear is so concave that the capsule does not snap through any more."""
    return bool(outcome.variables["parachute_depth"] > SHALLOW * outcome.size_ratio)


def _limit(outcome: Outcome, last: Outcome) -> float:
    """Return the Ca at which the branch of `last` ended on the way to a case, as far as it is known."""
    limit = float(outcome.variables.get("limit", np.nan))
    return limit if limit > last.capillary_number else last.capillary_number


def _approach(runner: CaseRunner, last: Outcome, limit: float) -> None:
    """Run cases between the last converged one and the end of its branch."""
    for share in _BELOW_LIMIT:
        ca = _rounded(share * limit)
        if ca > 1.01 * last.capillary_number:
            outcome = runner.run(ca, last)
            last = outcome if outcome.done else last


def _middle(last: Outcome, beyond: Outcome) -> float:
    return _rounded((last.capillary_number * beyond.capillary_number) ** 0.5)


def _rounded(capillary_number: float) -> float:
    return float(f"{capillary_number:.4g}")


def _skip_above(runner: CaseRunner, last: Outcome, above: Outcome, capillary_numbers: list[float]) -> None:
    """Give the cases above a limit its status, if that holds for everything above."""
    holds_above = above.status in (Status.NO_STEADY_STATE, Status.UNRESOLVED)
    for ca in capillary_numbers:
        runner.skip(ca, last, above.status if holds_above else Status.NOT_TRIED)


def _downward(runner: CaseRunner, first: Outcome, capillary_numbers: list[float]) -> None:
    last, failures = first, 0
    for ca in capillary_numbers:
        if failures == _FAILURES_DOWNWARD:
            runner.skip(ca, last, Status.NOT_TRIED)
            continue
        outcome = runner.run(ca, last)
        failures = 0 if outcome.done else failures + 1
        last = outcome if outcome.done else last
