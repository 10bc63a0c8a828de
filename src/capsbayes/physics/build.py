"""Databases of steady shapes: the cases of each size ratio, computed in parallel and resumed after an interruption."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import partial
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

import capsbayes
from capsbayes.arguments import checked
from capsbayes.database import (
    LIMIT_OF_DATABASE,
    LIMIT_OF_EXISTENCE,
    LOST_FROM_REST,
    NO_EFFECT,
    SNAP_THROUGH,
    VARIABLES,
    Database,
)
from capsbayes.errors import InputError
from capsbayes.files.csv_file import read_numbers
from capsbayes.files.output_file import check_replaceable, guarded
from capsbayes.interruption import keeping, raise_interruption
from capsbayes.physics.continuation import SHALLOW
from capsbayes.physics.load import changed, parameters_of
from capsbayes.prediction import ERRING
from capsbayes.run import Store, only_run, progress_bar, run_tasks, steps_kept
from capsbayes.status import Status

# The cases that databases cover by default, dense at low capillary number

Case = tuple[float, float]
Cases = list[Case]
"""Capillary numbers and size ratios."""

# fmt: off
CAPILLARY_NUMBERS = (
    0.003, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.0175, 0.02, 0.025, 0.03, 0.035, 0.04,
    0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11, 0.12, 0.135, 0.15,
)
# fmt: on


def default_grid() -> Cases:
    """Return cases (Ca, a/l) with a/l from 0.70 to 1.15 by 0.025 and Ca from 0.003 to 0.15, sorted by a/l.

    >>> len(default_grid()), default_grid()[0], default_grid()[-1]
    (418, (0.003, 0.7), (0.15, 1.15))
    """
    return grid(CAPILLARY_NUMBERS, 0.7, 0.025, 19)


def grid(capillary_numbers: tuple[float, ...], first: float, step: float, count: int) -> Cases:
    """Return each Ca with each of some a/l, given the first of these, their step and their number."""
    size_ratios = [round(first + step * place, 3) for place in range(count)]
    return [(capillary_number, size_ratio) for size_ratio in size_ratios for capillary_number in capillary_numbers]


def read_cases(path: str | os.PathLike[str]) -> Cases:
    """Read the cases of a CSV file with columns ``capillary_number`` and ``size_ratio``; refuse a wrong line."""
    numbers = read_numbers(Path(path), ("capillary_number", "size_ratio"), "table of cases")
    return [(capillary_number, size_ratio) for capillary_number, size_ratio in numbers.tolist()]


# The outcome of a simulated case: its row of the database, its steady state, and both as a part of a store

OUTLINE_POINTS = 256

_VARIABLE, _STATE = "variable ", "state "


@dataclass(frozen=True, eq=False)
class CaseOutcome:
    """Outcome of one case."""

    capillary_number: float
    size_ratio: float
    start: float | str  # Ca of the state it started from, "rest", or "parachute" for the first one found
    status: Status
    variables: dict[str, Any] = field(default_factory=dict)  # the row of the database; without NaN only if DONE
    state: Any = None  # the steady state if DONE
    message: str = ""  # the error that was raised

    @property
    def done(self) -> bool:
        """True when the case converged."""
        return self.status is Status.DONE

    def save(self, store: Store) -> None:
        """Keep the outcome."""
        values: dict[str, Any] = {"message": self.message}
        values |= {_VARIABLE + name: value for name, value in self.variables.items()}
        if self.state is not None:  # its status is DONE
            stored = {item.name: getattr(self.state, item.name) for item in fields(self.state)}
            values |= {_STATE + name: value for name, value in stored.items() if name != "status"}
        name = f"{name_of(self.capillary_number, self.size_ratio, self.start)}.{self.status.name}"
        store.save(name, values)

    @classmethod
    def find(
        cls,
        store: Store,
        capillary_number: float,
        size_ratio: float,
        start: float | str,
        rebuild: Callable[[Mapping[str, Any]], Any],
    ) -> CaseOutcome | None:
        """Return the outcome of a case that has ended before from this start, else None; refuse other settings."""
        # `rebuild` makes a steady state from the values of its fields.
        for name in sorted(store.names(f"{name_of(capillary_number, size_ratio, start)}.*")):
            values = store.load(name)
            if values is not None:
                status = Status[name.rpartition(".")[2]]
                variables, of_state = _with_prefix(values, _VARIABLE), _with_prefix(values, _STATE)
                state = rebuild(of_state | {"status": status}) if of_state else None
                return cls(capillary_number, size_ratio, start, status, variables, state, values["message"])
        return None


def variables_of(state: Any) -> dict[str, Any]:
    """Return the variables of a steady state in its row of the database, without a shape if it did not converge."""
    row: dict[str, Any] = {
        "residual": float(state.residual),
        "slack": float(state.slack),
        "iterations": int(state.iterations),
        "limit": float(state.limit),
    }
    if state.status is not Status.DONE:
        return row
    profile, tensions, places = state.profile, state.principal_tensions, state.surface_nodes
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
        "minimum_tension": float(np.min(tensions)),
        "maximum_tension": float(np.max(tensions)),
        "minimum_tension_place": places[np.argmin(tensions[:, 1])],
        "maximum_tension_place": places[np.argmax(tensions[:, 0])],
        "nodes": np.array(state.nodes, dtype=float),
        "profile": np.array(profile.resampled(OUTLINE_POINTS).points),
        "silhouette": np.array(state.silhouette.resampled(OUTLINE_POINTS).points),
    }


def count_ended(store: Store, cases: Iterable[tuple[float, float]]) -> tuple[int, int]:
    """Count the cases (Ca, a/l) that have ended, and those of them that have not converged."""
    statuses: dict[str, set[str]] = {}
    for name in store.names():
        case, _, rest = name.partition("_from-")
        statuses.setdefault(case, set()).add(rest.rpartition(".")[2])
    ended = [known for case in cases if (known := statuses.get(_case_name(*case)))]
    return len(ended), sum(Status.DONE.name not in known for known in ended)


def _with_prefix(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {key.removeprefix(prefix): value for key, value in values.items() if key.startswith(prefix)}


def _case_name(capillary_number: float, size_ratio: float) -> str:
    return f"size-{size_ratio!r}_ca-{capillary_number!r}"


def name_of(capillary_number: float, size_ratio: float, start: float | str) -> str:
    """Return the name of a case that is started from another."""
    return f"{_case_name(capillary_number, size_ratio)}_from-{start if isinstance(start, str) else repr(start)}"


# Differences between the cases of a database and those of a finer mesh

_PLACES = ((0.1, 0.3), (0.3, 0.8), (0.5, 0.5), (0.7, 0.2), (0.9, 0.7))
"""Ranks of the compared cases: of the sweep among the sweeps, and of the case within its sweep."""


def chosen_cases(sweeps: Sequence[Sequence[CaseOutcome]]) -> list[CaseOutcome]:
    """Choose five converged cases spread over sweeps of rising size and Ca, fewer if there are not enough sweeps."""
    converged = [[outcome for outcome in sweep if outcome.done] for sweep in sweeps]
    filled = [sweep for sweep in converged if sweep]
    chosen = {}
    for across, along in _PLACES if filled else ():
        sweep = filled[round(across * (len(filled) - 1))]
        outcome = sweep[round(along * (len(sweep) - 1))]
        chosen[outcome.size_ratio, outcome.capillary_number] = outcome
    return [chosen[key] for key in sorted(chosen)]


def mesh_error(refinement: int, coarse: Sequence[CaseOutcome], fine: Sequence[CaseOutcome]) -> str:
    """Return relative differences from a finer mesh as JSON: rms over the cases of each quantity, and every case's."""
    rows = [
        {"capillary_number": ours.capillary_number, "size_ratio": ours.size_ratio}
        | {name: ours.variables[name] / finer.variables[name] - 1 for name in ERRING}
        for ours, finer in zip(coarse, fine, strict=True)
        if finer.done
    ]
    squares = {name: np.mean([row[name] ** 2 for row in rows]) if rows else np.nan for name in ERRING}
    summary = {name: float(np.sqrt(value)) for name, value in squares.items()}
    return json.dumps(summary | {"refinement": refinement, "cases": rows}, sort_keys=True)


# A sweep in Ca: all cases of one size ratio, one after the other, each from a converged neighbour.
#
# A steady state costs little when it starts from a near one. The sweep goes upward from the lowest capillary number,
# along the branch of a capsule at rest. Where that branch ends or becomes unstable a capsule snaps through to a
# parachute, and the sweep goes on along the parachutes until they end too. Then the shapes below are confirmed from
# rest, from the highest Ca downward. Each case depends only on the outcomes of earlier ones, which are stored: an
# interrupted sweep repeats the same steps with the stored outcomes and ends with the same numbers

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


Start = CaseOutcome | Literal["rest", "parachute"]


class Border(NamedTuple):
    """End of a branch in a sweep: the capillary number there, and the kind of border (see `capsbayes.database`)."""

    size_ratio: float
    capillary_number: float
    kind: str


class Sweep(NamedTuple):
    """Outcomes of one size ratio in rising Ca, and the ends of its branches; none if no case converged."""

    outcomes: list[CaseOutcome]
    borders: list[Border]


@dataclass(frozen=True)
class CaseRunner:
    """Runner of the cases of one size ratio: it takes them from the store, or computes them with the simulator."""

    simulator: SteadySimulator
    store: Store
    size_ratio: float
    final: dict[float, CaseOutcome] = field(default_factory=dict)  # the last outcome of each case

    def run(self, capillary_number: float, start: Start) -> CaseOutcome:
        """Return the outcome of one case; an error of the simulator is an outcome too."""
        origin = start if isinstance(start, str) else start.capillary_number
        outcome = self._stored(capillary_number, origin) or self._computed(capillary_number, start, origin)
        self.final[capillary_number] = outcome
        return outcome

    def skip(self, capillary_number: float, start: CaseOutcome, status: Status) -> None:
        """Give a case a status without running it."""
        origin = start.capillary_number
        outcome = self._stored(capillary_number, origin)
        if outcome is None:
            outcome = CaseOutcome(capillary_number, self.size_ratio, origin, status)
            outcome.save(self.store)
        self.final[capillary_number] = outcome

    def _stored(self, capillary_number: float, origin: float | str) -> CaseOutcome | None:
        return CaseOutcome.find(self.store, capillary_number, self.size_ratio, origin, self.simulator.restored)

    def _computed(self, capillary_number: float, start: Start, origin: float | str) -> CaseOutcome:
        case = (capillary_number, self.size_ratio, origin)
        try:
            with steps_kept(self.store, name_of(*case)):
                state = self.simulator.run(
                    capillary_number=capillary_number,
                    size_ratio=self.size_ratio,
                    start=start if isinstance(start, str) else start.state,
                )
            kept = state if state.status is Status.DONE else None
            outcome = CaseOutcome(*case, state.status, variables_of(state), kept)
        except Exception as error:  # the other cases go on; this one keeps the reason
            raise_interruption(error)
            outcome = CaseOutcome(*case, Status.RAISED, message=f"{type(error).__name__}: {error}")
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


def _first_converged(runner: CaseRunner, ordered: list[float]) -> CaseOutcome | None:
    nearest = [min(ordered, key=lambda ca: abs(np.log(ca / tried))) for tried in _FIRST_TRIED]
    candidates = dict.fromkeys([ordered[0], *nearest, *ordered])
    return _first_done(runner.run(ca, "rest") for ca in candidates)


def _first_done(outcomes: Iterable[CaseOutcome]) -> CaseOutcome | None:
    return next((outcome for outcome in outcomes if outcome.done), None)


def _upward(runner: CaseRunner, first: CaseOutcome, capillary_numbers: list[float]) -> list[Border]:
    last, convex, lost = first, [first], []
    upper = None
    for position, ca in enumerate(capillary_numbers):
        outcome = runner.run(ca, last)
        if outcome.status is Status.RAISED:
            continue
        if not outcome.done:
            # where the branch of the last one ended, as far as it is known
            limit = float(np.fmax(outcome.variables.get("limit", np.nan), last.capillary_number))
            # of a capsule whose branch has ended: the state it reaches from rest, or a parachute
            tried: tuple[Start, ...] = () if _is_deep(last) else ("rest", "parachute")
            beyond = _first_done(runner.run(ca, start) for start in tried)
            if beyond is None:
                runner.final[ca] = outcome
                _approach(runner, last, limit)
                kind = LIMIT_OF_EXISTENCE if outcome.status is Status.NO_STEADY_STATE else LIMIT_OF_DATABASE
                upper = Border(runner.size_ratio, limit, kind)
                holds_above = outcome.status in (Status.NO_STEADY_STATE, Status.UNRESOLVED)
                for above in capillary_numbers[position + 1 :]:
                    runner.skip(above, last, outcome.status if holds_above else Status.NOT_TRIED)
                break
            if beyond.start == "parachute":
                lost = [Border(runner.size_ratio, limit, LOST_FROM_REST)]
            outcome = beyond
        if not _is_deep(last):
            convex.append(outcome)
        last = outcome
    end = upper or Border(runner.size_ratio, last.capillary_number, LIMIT_OF_DATABASE)
    return [*(lost or _snap_through(runner, _confirmed(runner, convex))), end]


def _confirmed(runner: CaseRunner, followed: list[CaseOutcome]) -> list[CaseOutcome]:
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


def _snap_through(runner: CaseRunner, outcomes: list[CaseOutcome]) -> list[Border]:
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


def _has_snapped(last: CaseOutcome, outcome: CaseOutcome) -> bool:
    """Return whether a capsule is so much shorter than the last one as a snap-through makes it."""
    return outcome.done and outcome.variables["axial_extent"] < (1.0 - _SNAPPED) * last.variables["axial_extent"]


def _is_deep(outcome: CaseOutcome) -> bool:
    """Return whether the rear is so concave that the capsule does not snap through any more."""
    return bool(outcome.variables["parachute_depth"] > SHALLOW * outcome.size_ratio)


def _approach(runner: CaseRunner, last: CaseOutcome, limit: float) -> None:
    """Run cases between the last converged one and the end of its branch."""
    for share in _BELOW_LIMIT:
        ca = _rounded(share * limit)
        if ca > 1.01 * last.capillary_number:
            outcome = runner.run(ca, last)
            last = outcome if outcome.done else last


def _middle(last: CaseOutcome, beyond: CaseOutcome) -> float:
    return _rounded((last.capillary_number * beyond.capillary_number) ** 0.5)


def _rounded(capillary_number: float) -> float:
    return float(f"{capillary_number:.4g}")


def _downward(runner: CaseRunner, first: CaseOutcome, capillary_numbers: list[float]) -> None:
    last, failures = first, 0
    for ca in capillary_numbers:
        if failures == _FAILURES_DOWNWARD:
            runner.skip(ca, last, Status.NOT_TRIED)
            continue
        outcome = runner.run(ca, last)
        failures = 0 if outcome.done else failures + 1
        last = outcome if outcome.done else last


# Gather the outcomes of sweeps in one database with its pedigree

_OUTLINE = (OUTLINE_POINTS, 2)
_PLACE = {"minimum_tension_place": (3,), "maximum_tension_place": (3,)}
_SHAPES: dict[str, tuple[int, ...]] = {"nodes": (0, 3), "profile": _OUTLINE, "silhouette": _OUTLINE, **_PLACE}


def gathered(
    sweeps: Mapping[float, list[Sweep]], settings: Mapping[str, Any], attributes: Mapping[str, str | int | float]
) -> Database:
    """Return one database of all sweeps by value of the effect; what a case lacks is NaN, or 0 for an integer."""
    # An effect database is compact: it serves for differences, and has ten times the cases.
    by_value = [(value, sweep) for value, several in sweeps.items() for sweep in several]
    outcomes = [(value, outcome) for value, sweep in by_value for outcome in sweep.outcomes]
    borders = [(value, border) for value, sweep in by_value for border in sweep.borders]
    shapes = dict(_SHAPES)
    for _, outcome in outcomes:
        shapes |= {name: np.shape(value) for name, value in outcome.variables.items()}
    rows: dict[str, list[Any]] = {name: [] for name, variable in VARIABLES.items() if variable.dims[0] == "case"}
    for value, outcome in outcomes:
        known = outcome.variables | {
            "capillary_number": outcome.capillary_number,
            "size_ratio": outcome.size_ratio,
            "effect_value": value,
            "status": outcome.status.name,
            "refinement": int(settings["refinement"]),
        }
        for name, values in rows.items():
            lacking = 0 if VARIABLES[name].kind == "i" else np.full(shapes.get(name, ()), np.nan)
            values.append(known.get(name, lacking))
    border_columns = {f"border_{name}": [getattr(border, name) for _, border in borders] for name in Border._fields}
    border_columns["border_effect_value"] = [value for value, _ in borders]
    database = Database.assemble(rows | border_columns, attributes)
    return database if attributes["effect"] == NO_EFFECT else database.compact()


def pedigree(settings: Mapping[str, Any], effect: str = NO_EFFECT, null_value: float = 0.0) -> dict[str, Any]:
    """Return the attributes of a database made now by this version, with the simulator's settings at the null value."""
    law, cross_section = settings["law"], str(settings["cross_section"])
    if cross_section == "rectangular" and settings.get("section_aspect") == 1.0:
        cross_section = "square"  # whatever symmetry it was computed with
    channel = f"a channel of {cross_section} cross-section"
    varied = "" if effect == NO_EFFECT else f", over {effect.replace('_', ' ')}"
    return {
        "title": f"Steady shapes of capsules with a {law} membrane in {channel}{varied}",
        "source": "capsbayes, boundary integrals for the liquids and finite elements for the membrane",
        "law": law,
        "cross_section": cross_section,
        "bending": float(settings["bending"]),
        "pre_inflation": float(settings["pre_inflation"]),
        "effect": effect,
        "null_value": float(null_value),
        "settings": json.dumps(dict(settings), sort_keys=True),
        "version": capsbayes.__version__,
        "created": _now(),
    }


def _now() -> str:
    """Return the time of the build, or the one that the environment prescribes for reproducible files."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    moment = datetime.fromtimestamp(int(seconds), UTC) if seconds else datetime.now(UTC)
    return moment.isoformat(timespec="seconds")


# Build a database: sweeps in parallel, each finished case kept, nothing lost by an interruption

_logger = logging.getLogger(__name__)
_FEWEST_VALUES = 3  # if one is held out, two still define a slope


@checked
@guarded()
def build_database(
    simulator: SteadySimulator,
    cases: Iterable[Case],
    *,
    out: str | os.PathLike[str],
    effect: str | None = None,
    values: Iterable[float] = (),
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
    compare: int | None = None,
    compact: bool = False,
) -> Database:
    """Simulate many cases and write them as one database.

    Finished cases are kept in the folder ``<out>.parts``. The same call made again, after an interruption or with more
    cases or values, computes only what is missing; the result does not depend on interruptions or on the number of
    workers. A case that fails is a row with its status.

    An effect database has the same cases at each of a few values of one more parameter. It serves for differences from
    the null value on the same mesh, which are added to a database of a finer mesh; so its own mesh may be coarser.

    Parameters
    ----------
    simulator : Simulator
        Must be picklable; for an effect database a dataclass, whose own value of the parameter is the null value.
    cases : iterable of (capillary_number, size_ratio)
        In any order; cases of one size ratio are run one after the other.
    out : path
        The NetCDF file to write.
    effect : str, optional
        Name of a parameter of the simulator, as ``"pre_inflation"``, or of its membrane law, as ``"hardening"``.
    values : iterable of float
        Values of the effect: at least three, the null value among them.
    scheduler : str, optional
        Address of a dask cluster (``"tcp://host:port"``) that sees the same files, or ``"synchronous"`` for this
        process alone. By default, worker processes on this machine.
    workers : int, optional
        Number of worker processes on this machine; by default, one for each core.
    progress : bool
        Whether to show a progress bar, on a terminal only.
    compare : int, optional
        Refinement of a finer mesh on which five of the cases are run again; the differences are stored in the
        attribute ``mesh_error``. The simulator then needs a method ``refined(refinement)``. Not for an effect.
    compact : bool
        Write it as `Database.compact` returns it.

    Returns
    -------
    Database
        As written, sorted by value of the effect, size ratio, capillary number; that of an effect without nodes.

    Raises
    ------
    InputError
        If there are no cases, or one is not positive, there is no such parameter, the values are too few or lack the
        null value, another run writes `out`, or no cluster answers.
    DatabaseError
        If ``<out>.parts`` was made with other settings.
    """
    check_replaceable(Path(out))
    ordered, folder = _checked_cases(cases), Path(f"{os.fspath(out)}.parts")
    varied = {0.0: simulator} if effect is None else _simulators_at(simulator, effect, values)
    with only_run(Path(out)), keeping(folder):
        if effect is None:
            attributes = pedigree(simulator.settings)
            stores = [Store.open(folder, simulator.settings)]
        else:
            attributes = pedigree(simulator.settings, effect, _null_value(simulator, effect))
            stores = [Store.open(folder / f"{effect}-{value!r}", changed.settings) for value, changed in varied.items()]
        sizes = sorted({size for _, size in ordered})
        by_size = {size: [ca for ca, other in ordered if other == size] for size in sizes}
        tasks = [
            [partial(_run_sweep, simulated, store, *of_size) for of_size in by_size.items()]
            for simulated, store in zip(varied.values(), stores, strict=True)
        ]
        sweeps = iter(_run_sweeps(list(chain(*tasks)), stores, ordered, scheduler, workers, progress=progress))
        by_value = {value: list(islice(sweeps, len(some))) for value, some in zip(varied, tasks, strict=True)}
        if compare is not None and effect is None:
            attributes |= {"mesh_error": _compared(simulator, stores[0], by_value[0.0], compare, scheduler, workers)}
        database = gathered(by_value, simulator.settings, attributes)
        if compact:
            database = database.compact()
        database.write(out)
    return database


def _checked_cases(cases: Iterable[Case]) -> list[Case]:
    """Return the cases once each, sorted by size ratio, then capillary number; refuse none or one not positive."""
    ordered = sorted({(float(size), float(ca)) for ca, size in cases})
    if not ordered:
        raise InputError("cases", "", "at least one case (capillary number, size ratio)", "none")
    for size, ca in ordered:
        if not (0.0 < size < np.inf and 0.0 < ca < np.inf):
            raise InputError("cases", "", "positive capillary numbers and size ratios", f"Ca = {ca}, a/l = {size}")
    return [(ca, size) for size, ca in ordered]


def _run_sweeps(
    tasks: list[Callable[[], Sweep]],
    stores: list[Store],
    cases: list[Case],
    scheduler: str | None,
    workers: int | None,
    *,
    progress: bool,
) -> list[Sweep]:
    """Run the tasks of all stores, with a bar that counts the cases, and log the errors of the simulator."""

    def count() -> tuple[int, str]:
        ended, failed = np.sum([count_ended(store, cases) for store in stores], axis=0)
        return int(ended), f"cases, {failed} without a steady state"

    with progress_bar(len(stores) * len(cases), "cases", show=progress, count=count):
        sweeps = run_tasks(tasks, scheduler, workers)
    messages = Counter(outcome.message for sweep in sweeps for outcome in sweep.outcomes if outcome.message)
    for message, number in messages.most_common():
        _logger.warning("%d cases broke off with %s", number, message)
    return sweeps


def _run_sweep(simulator: SteadySimulator, store: Store, size_ratio: float, capillary_numbers: list[float]) -> Sweep:
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    with threadpool_limits(limits=1):
        return sweep(CaseRunner(simulator, store, size_ratio), capillary_numbers)


def _compared(
    simulator: Any, store: Store, sweeps: list[Sweep], refinement: int, scheduler: str | None, workers: int | None
) -> str:
    """Return the mesh error of some cases from a finer mesh, whose cases are kept in a folder of their own."""
    finer = simulator.refined(refinement)
    kept = Store.open(store.folder / f"refinement-{refinement}", finer.settings)
    coarse = chosen_cases([sweep.outcomes for sweep in sweeps])
    fine = run_tasks([partial(_run_again, finer, kept, outcome) for outcome in coarse], scheduler, workers)
    return mesh_error(refinement, coarse, fine)


def _run_again(simulator: SteadySimulator, store: Store, outcome: CaseOutcome) -> CaseOutcome:
    """Run the case of `outcome` with another simulator, started from its steady state."""
    with threadpool_limits(limits=1):
        return CaseRunner(simulator, store, outcome.size_ratio).run(outcome.capillary_number, outcome)


def _null_value(simulator: Any, effect: str) -> float:
    """Return the simulator's own value of a parameter, the null value of the effect; refuse an unknown parameter."""
    known = parameters_of(simulator)
    if effect not in known:
        raise InputError("build", "effect", f"one of {', '.join(known)}", repr(effect))
    return known[effect]


def _simulators_at(simulator: Any, effect: str, values: Iterable[float]) -> dict[float, Any]:
    """Return the simulator at each value of a parameter, in rising order; refuse too few, or without the null value."""
    null, ordered = _null_value(simulator, effect), sorted({float(value) for value in values})
    if len(ordered) < _FEWEST_VALUES or null not in ordered:
        expected = f"at least {_FEWEST_VALUES} values of {effect}, the simulator's own {null:g} among them"
        raise InputError("build", "values", expected, ", ".join(f"{value:g}" for value in ordered) or "none")
    return {value: changed(simulator, effect, value) for value in ordered}
