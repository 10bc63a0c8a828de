"""States scattered over flow and membrane: how they are computed and kept."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.interruption import keeping
from capsbayes.membrane_database import FREE_PARAMETERS, OMITTED, RANGES, MembraneDatabase, fewest_modes
from capsbayes.physics import load as outlines
from capsbayes.physics.build import OUTLINE_POINTS
from capsbayes.physics.load import changed, parameters_of
from capsbayes.physics.membrane import GeneralLaw
from capsbayes.physics.simulator import Simulator, SteadyState
from capsbayes.physics.steady import Iterate, Problem, parameter_derivatives, steady_state
from capsbayes.physics.surface import prolonged
from capsbayes.prediction import NUMBERS
from capsbayes.run import Store, digest_of, only_run, progress_bar, run_tasks

if TYPE_CHECKING:
    import xarray as xr


# Steady states scattered over several parameters, each with its derivatives along all of them.
#
# A state and its derivatives predict its neighbours, so that Newton's method reaches one from the nearest in few steps.
# The places form a tree in which each is near its parent: first a few that are far apart, then the others, each in the
# group of the nearest of these. Where a branch seems to end on the way, a place is tried again from the nearest of all
# states that were found. The groups are independent, and the tree depends on the places alone: results do not depend on
# interruptions or on the number of workers

_OF_THE_CASE = ("capillary_number", "size_ratio")
_GROUPS = 32
_SHORTEST = 0.05  # share of the way to a place, below which a step is not tried
_FARTHEST = 0.05  # [l] between the prediction and the state, beyond which it may be one of another branch
_TOO_FAR = 1.0  # [l] between a state and its prediction; derivatives of what is no state on the mesh reach beyond
_ITERATIONS, _PATIENCE = 8, 4
_SMOOTH = 13  # degree on the sphere up to which a stored shape is taken as it is
_STEP = 1e-4  # of coordinates from 0 to 1, for the differences of outlines

TENSIONS = ("largest", "smallest")
"""Extremes of the principal tensions of a state [G_s]."""


class ExtremeTensions(NamedTuple):
    """The `TENSIONS` (2,) [G_s] and the nodes where they lie (2, 3) [l], the last coordinate along the axis."""

    values: Floats
    places: Floats


@dataclass(frozen=True)
class Axis:
    """A parameter, of the case, the simulator or its law, and its range."""

    name: str
    low: float
    high: float
    offset: float | None = None  # linear in the logarithm of value and this together; None: in the value

    def value(self, unit: float) -> float:
        """Return the value at a coordinate from 0 to 1."""
        if unit == 1.0:  # not beyond the end by a rounding error
            return self.high
        if self.offset is None:
            return self.low + (self.high - self.low) * unit
        return float((self.low + self.offset) * np.exp(unit * self._ratio)) - self.offset

    def unit(self, value: float) -> float:
        """Return the coordinate of a value."""
        if self.offset is None:
            return (value - self.low) / (self.high - self.low)
        return float(np.log((value + self.offset) / (self.low + self.offset))) / self._ratio

    def slope(self, unit: float) -> float:
        """Return the derivative of the value along the coordinate."""
        return self.high - self.low if self.offset is None else (self.value(unit) + self.offset) * self._ratio

    @property
    def _ratio(self) -> float:
        assert self.offset is not None
        return float(np.log((self.high + self.offset) / (self.low + self.offset)))


@dataclass(frozen=True, eq=False)
class ScatteredState:
    """A steady state at a place."""

    place: Floats  # (p,): coordinates from 0 to 1 along the axes
    unknowns: Floats  # (F + 2,): free coordinates of the mesh [l], velocity [U] and slack [U]
    derivatives: Floats  # (F + 2, p): of the unknowns along the coordinates

    @property
    def slack(self) -> float:
        """Uniform normal velocity left over [U], an indicator of the mesh's error."""
        return float(self.unknowns[-1])

    def moved(self, change: Floats) -> ScatteredState:
        """Return what it predicts at another place, a change (p,) away."""
        return replace(self, place=self.place + change, unknowns=self.unknowns + self.derivatives @ change)


@dataclass(frozen=True)
class Continuation:
    """Continuation of the steady states of one simulator along axes, capillary number and size ratio among them."""

    simulator: Simulator
    axes: tuple[Axis, ...]

    def __post_init__(self) -> None:
        for name in _OF_THE_CASE:
            if name not in self.names:
                raise InputError("Continuation", "axes", f"{name} among the axes", ", ".join(self.names) or "none")
        known = (*_OF_THE_CASE, *parameters_of(self.simulator.problem))
        for name in self.names:
            if name not in known:
                raise InputError("Continuation", "axes", f"some of {', '.join(known)}", repr(name))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(axis.name for axis in self.axes)

    def values(self, places: Floats) -> Floats:
        """Return the values (n, p) of the parameters at places (n, p)."""
        columns = zip(self.axes, places.T.tolist(), strict=True)
        return np.array([[axis.value(unit) for unit in column] for axis, column in columns]).T

    def places(self, values: Floats) -> Floats:
        """Return the places (n, p) of values (n, p) of the parameters."""
        columns = zip(self.axes, values.T.tolist(), strict=True)
        return np.array([[axis.unit(value) for value in column] for axis, column in columns]).T

    def seen(self, state: ScatteredState) -> dict[str, Floats]:
        """Return the `NUMBERS` of a state and its outlines : (4,) and (512,) arrays by name."""
        mesh = self.simulator.problem.mesh
        nodes = mesh.expanded(state.unknowns[:-2])
        profile, silhouette = outlines.profile(mesh, nodes), outlines.silhouette(mesh, nodes)
        stretch = profile.stretch_ratio(self._values(state.place)["size_ratio"])
        return {
            "numbers": np.array([profile.axial_extent, profile.axial_length, state.unknowns[-2], stretch]),
            "profile": profile.resampled(OUTLINE_POINTS).points.ravel(),
            "silhouette": silhouette.resampled(OUTLINE_POINTS).points.ravel(),
        }

    def extreme_tensions(self, state: ScatteredState) -> ExtremeTensions:
        """Return the `TENSIONS` of a state."""
        membrane = self._problem(state.place).membrane(self._values(state.place)["size_ratio"])
        tensions = membrane.principal_tensions(state.unknowns[:-2])
        nodes = [int(np.argmax(tensions[:, 0])), int(np.argmin(tensions[:, 1]))]
        places = membrane.mesh.expanded(state.unknowns[:-2])[nodes]
        return ExtremeTensions(tensions[nodes, [0, 1]], places)

    @property
    def settings(self) -> dict[str, object]:
        """What decides the states, in types that JSON has."""
        return {**self.simulator.settings, "axes": [asdict(axis) for axis in self.axes]}

    def taken(self, state: SteadyState) -> ScatteredState:
        """Return a steady state of the simulator as a start."""
        problem = self.simulator.problem
        known = parameters_of(problem)
        values = [getattr(state, name) if name in _OF_THE_CASE else known[name] for name in self.names]
        place = np.array([axis.unit(value) for axis, value in zip(self.axes, values, strict=True)])
        unknowns = np.append(state.mesh.reduced(state.nodes), [state.velocity_ratio, state.slack])
        return self.with_derivatives(place, unknowns)

    def reached(self, start: ScatteredState, place: Floats, *, derivatives: bool = True) -> ScatteredState | None:
        """Return the state at a place, on the branch of another state; None if that ends on the way."""
        state, share, step = start, 0.0, 1.0
        while share < 1.0:
            step = min(step, 1.0 - share)
            last = share + step >= 1.0
            ahead = self._solved(state, start.place + (share + step) * (place - start.place), derivatives or not last)
            if ahead is not None:
                state, share, step = ahead, share + step, 2.0 * step
            elif step < 2.0 * _SHORTEST:
                return None
            else:
                step *= 0.5
        return state

    def _solved(self, near: ScatteredState, place: Floats, derivatives: bool) -> ScatteredState | None:
        guess = near.moved(place - near.place)
        if np.max(np.abs(guess.unknowns - near.unknowns)) > _TOO_FAR:
            return None
        return self.corrected(guess, derivatives=derivatives)

    def corrected(self, guess: ScatteredState, *, derivatives: bool = True) -> ScatteredState | None:
        """Return the state at the place of a guess, with the derivatives of its own; None if there is none near it."""
        problem, iterate = self._problem(guess.place), self._iterate(guess.place, guess.unknowns)
        end = steady_state(problem, iterate, max_iterations=_ITERATIONS, patience=_PATIENCE)
        unknowns = np.append(end.iterate.free, [end.iterate.velocity, end.iterate.slack])
        if not end.converged or np.max(np.abs(unknowns - guess.unknowns)) > _FARTHEST:
            return None
        if not derivatives:
            return ScatteredState(guess.place, unknowns, np.full_like(guess.derivatives, np.nan))
        return self.with_derivatives(guess.place, unknowns)

    def smoothed(self, guess: ScatteredState) -> ScatteredState:
        """Return a guess without the forces that its finest displacements bear."""
        iterate = self._iterate(guess.place, guess.unknowns)
        membrane = self._problem(guess.place).membrane(iterate.size_ratio)
        shape = membrane.smoothed(iterate.free, _SMOOTH)
        return replace(guess, unknowns=np.append(shape, guess.unknowns[-2:]))

    def with_derivatives(self, place: Floats, unknowns: Floats) -> ScatteredState:
        """Return a state that is known at a place, with its derivatives."""
        along = parameter_derivatives(self._problem(place), self._iterate(place, unknowns), self.names)
        slopes = [axis.slope(unit) for axis, unit in zip(self.axes, place.tolist(), strict=True)]
        return ScatteredState(place, unknowns, along * slopes)

    def _values(self, place: Floats) -> dict[str, float]:
        return {axis.name: axis.value(unit) for axis, unit in zip(self.axes, place.tolist(), strict=True)}

    def _problem(self, place: Floats) -> Problem:
        problem = self.simulator.problem
        for name, value in self._values(place).items():
            if name not in _OF_THE_CASE:
                problem = changed(problem, name, value)
        return problem

    def _iterate(self, place: Floats, unknowns: Floats) -> Iterate:
        values = self._values(place)
        return Iterate(unknowns[:-2], *map(float, unknowns[-2:]), *(values[name] for name in _OF_THE_CASE))


def scattered_states(
    continuation: Continuation,
    start: ScatteredState,
    places: Floats,
    *,
    folder: str | os.PathLike[str],
    groups: int = _GROUPS,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> list[ScatteredState | None]:
    """Compute the states at places (n, p) on the branch of a first one, None where it ends; keep them in a folder."""
    store = Store.open(folder, continuation.settings)
    first = min(groups, len(places))
    with only_run(Path(folder)), keeping(Path(folder)):
        count = partial(_ended, store, places)
        with progress_bar(len(places), "states", show=progress, count=count):
            seeds = [state for state in _grown(continuation, store, start, places[:first]) if state is not None]
            seeds = seeds or [start]
            nearest = np.argmin(cdist(places[first:], np.array([seed.place for seed in seeds])), axis=1)
            about = [(seed, places[first:][nearest == number]) for number, seed in enumerate(seeds)]
            tasks = [partial(_grown, continuation, store, seed, group) for seed, group in about if len(group)]
            run_tasks(tasks, scheduler, workers)
            states = [_stored(store, _name(place)) for place in places]
            return _lost_ones_again(continuation, store, places, states, scheduler, workers)


def _lost_ones_again(
    continuation: Continuation,
    store: Store,
    places: Floats,
    states: Sequence[ScatteredState | None],
    scheduler: str | None,
    workers: int | None,
) -> list[ScatteredState | None]:
    """Return the states, those that were lost tried again from the nearest of the others."""
    known = [state for state in states if state is not None]
    lost = [number for number, state in enumerate(states) if state is None]
    if not known or not lost:
        return list(states)
    nearest = np.argmin(cdist(places[lost], np.array([state.place for state in known])), axis=1)
    again = []
    for near, place in zip([known[number] for number in nearest], places[lost], strict=True):
        name = f"again-{digest_of(place, near.place)[:24]}"
        again.append(partial(kept_state, store, name, partial(continuation.reached, near, place)))
    reached = dict(zip(lost, run_tasks(again, scheduler, workers), strict=True))
    return [reached.get(number, state) for number, state in enumerate(states)]


def _grown(
    continuation: Continuation, store: Store, root: ScatteredState, places: Floats
) -> list[ScatteredState | None]:
    """Compute the states at some places, each from the nearest one before it."""
    states: list[ScatteredState] = [root]
    found: list[ScatteredState | None] = [None] * len(places)
    for number in from_near_to_far(root.place, places):
        place = places[number]
        near = min(states, key=lambda state: float(np.linalg.norm(state.place - place)))
        state = found[number] = kept_state(store, _name(place), partial(continuation.reached, near, place))
        if state is not None:
            states.append(state)
    return found


def from_near_to_far(root: Floats, places: Floats) -> Iterator[int]:
    """Yield the numbers of the places, always that which is nearest to those before it (Prim's algorithm)."""
    distance = np.linalg.norm(places - root, axis=1)
    left = np.ones(len(places), dtype=bool)
    for _ in range(len(places)):
        number = int(np.argmin(np.where(left, distance, np.inf)))
        yield number
        left[number] = False
        distance = np.minimum(distance, np.linalg.norm(places - places[number], axis=1))


def _name(place: Floats) -> str:
    return f"state-{digest_of(place)[:24]}"


def kept_state(store: Store, name: str, compute: Callable[[], ScatteredState | None]) -> ScatteredState | None:
    """Return a state of the store, computed and saved first if it is not there."""
    if not store.holds(name):
        with threadpool_limits(limits=1):
            state = compute()
        store.save(name, {"reached": state is not None, **({} if state is None else vars(state))})
    return _stored(store, name)


def _stored(store: Store, name: str) -> ScatteredState | None:
    values = store.load(name)
    return ScatteredState(**values) if values is not None and values.pop("reached") else None


def _ended(store: Store, places: Floats) -> tuple[int, str]:
    there = set(store.names())
    return sum(_name(place) in there for place in places), "states"


def scattered_dataset(
    continuation: Continuation, places: Floats, states: Sequence[ScatteredState | None]
) -> xr.Dataset:
    """Return what capsules look like in the states at places (n, p): a dataset a hundred times smaller than these."""
    # ``values`` (n, p) of the parameters; ``numbers`` (n, 4), see `NUMBERS`; for either view the outlines in few modes,
    # ``profile`` (n, m), ``profile_mean`` (q, 2) and ``profile_modes`` (m, q, 2) [l]; ``*_along`` (n, m, p),
    # derivatives along the parameters; the free coordinates likewise, as starts of other states; the values ``lost``
    # (k, p); ``tension`` (n, 2), see `TENSIONS`, and where they lie, ``tension_place`` (n, 2, 3) [l].
    import xarray as xr

    some = [state for state in states if state is not None]
    lost = places[[state is None for state in states]]
    slopes = np.array([[axis.slope(unit) for axis, unit in zip(continuation.axes, s.place, strict=True)] for s in some])
    seen = [_seen(continuation, state) for state in some]
    tensions = [continuation.extreme_tensions(state) for state in some]
    numbers, numbers_along = (np.array([one["numbers"][part] for one in seen]) for part in (0, 1))
    tension_along = np.array([_tension_along(continuation, state) for state in some])
    variables: dict[str, tuple[tuple[str, ...], Floats]] = {
        "values": (("state", "parameter"), continuation.values(np.array([state.place for state in some]))),
        "lost": (("lost_state", "parameter"), continuation.values(lost)),
        "slack": (("state",), np.array([state.slack for state in some])),
        "numbers": (("state", "number"), numbers),
        "numbers_along": (("state", "number", "parameter"), numbers_along / slopes[:, None]),
        "tension": (("state", "extreme"), np.array([tension.values for tension in tensions])),
        "tension_along": (("state", "extreme", "parameter"), tension_along / slopes[:, None]),
        "tension_place": (("state", "extreme", "axis"), np.array([tension.places for tension in tensions])),
    }
    for view in ("profile", "silhouette"):
        modes = in_modes(np.array([one[view][0] for one in seen]))
        along = np.einsum("nqp,mq->nmp", np.array([one[view][1] for one in seen]), modes.modes) / slopes[:, None]
        variables |= {
            f"{view}_mean": (("point", "plane"), modes.mean.reshape(-1, 2)),
            f"{view}_modes": ((f"{view}_mode", "point", "plane"), modes.modes.reshape(-1, OUTLINE_POINTS, 2)),
            view: (("state", f"{view}_mode"), modes.coefficients),
            f"{view}_along": (("state", f"{view}_mode", "parameter"), along),
        }
    shapes = in_modes(np.array([state.unknowns[:-2] for state in some]))
    variables |= {"mesh_mean": (("coordinate",), shapes.mean), "mesh": (("state", "mesh_mode"), shapes.coefficients)}
    variables["mesh_modes"] = ("mesh_mode", "coordinate"), shapes.modes
    names = {"parameter": list(continuation.names), "number": list(NUMBERS), "plane": ["z", "y"]}
    names |= {"extreme": list(TENSIONS), "axis": ["x", "y", "z"]}
    return xr.Dataset(variables, names, {"settings": json.dumps(continuation.settings), "version": __version__})


class Modes(NamedTuple):
    """Vectors as their mean (d,) and coefficients (n, m) of orthonormal modes (m, d)."""

    mean: Floats
    modes: Floats
    coefficients: Floats


def in_modes(vectors: Floats, omitted: float = OMITTED) -> Modes:
    """Return vectors (n, d) [l] in the fewest modes that leave out no more than an rms."""
    mean = vectors.mean(axis=0)
    modes = fewest_modes(vectors - mean, omitted)
    return Modes(mean, modes, (vectors - mean) @ modes.T)


def _seen(continuation: Continuation, state: ScatteredState) -> dict[str, tuple[Floats, Floats]]:
    """Return numbers and outlines of a state, and their derivatives along the coordinates from 0 to 1."""
    here = continuation.seen(state)
    along: dict[str, list[Floats]] = {name: [] for name in here}
    for step in _STEP * np.eye(len(state.place)):
        ahead, behind = continuation.seen(state.moved(step)), continuation.seen(state.moved(-step))
        for name, values in along.items():
            values.append((ahead[name] - behind[name]) / (2.0 * _STEP))
    return {name: (values, np.stack(along[name], axis=-1)) for name, values in here.items()}


def _tension_along(continuation: Continuation, state: ScatteredState) -> Floats:
    """Return the derivatives (2, p) of the extreme tensions along the coordinates from 0 to 1."""
    along = []
    for step in _STEP * np.eye(len(state.place)):  # laws may have no values beyond the ends
        ends = np.clip([state.place - step, state.place + step], 0.0, 1.0)
        behind, ahead = (continuation.extreme_tensions(state.moved(end - state.place)).values for end in ends)
        along.append((ahead - behind) / np.sum(ends[1] - ends[0]))
    return np.stack(along, axis=-1)


# The states over flow and membrane that come with the library, and how they are continued

_OFFSETS = (0.0, None, 0.01, 0.0, None, 0.0)  # of the logarithms along which places are spread; None: evenly
_FARTHEST_CA = 0.25  # end of the axis of Ca, beyond the highest Ca of the states


def membrane_continuation(cross_section: str, refinement: int = 8) -> Continuation:
    """Return the continuation over `FREE_PARAMETERS` in a channel."""
    ranges = [(RANGES[0][0], _FARTHEST_CA), *RANGES[1:]]
    axes = (Axis(name, *ends, offset) for name, ends, offset in zip(FREE_PARAMETERS, ranges, _OFFSETS, strict=True))
    simulator = Simulator(
        GeneralLaw(3.0, 0.3),
        cross_section=cross_section,
        refinement=refinement,
        pre_inflation=0.02,
        bending=1e-4,
        bending_energy="curvature",
    )
    return Continuation(simulator, tuple(axes))


_STARTS = 2  # states from which a further one is tried
_TRIED = 8  # of the nearest states, some of which are not found on a finer mesh


def nearest_state(database: MembraneDatabase, continuation: Continuation, place: Floats) -> ScatteredState | None:
    """Return the state of a database next to a place (6,) that is found on the mesh of a continuation, or None."""
    nearest = nearest_numbers(database, continuation, place)[:_TRIED]
    guesses = (guess_of(database, continuation, number) for number in nearest)
    states = (continuation.corrected(guess) for guess in guesses)
    return next((state for state in states if state is not None), None)


Way = Callable[[MembraneDatabase, Continuation, Floats], ScatteredState | None]
"""How the state at a place (6,) is found from those of a database, None if it is not."""


def from_the_nearest(database: MembraneDatabase, continuation: Continuation, place: Floats) -> ScatteredState | None:
    """Return the state at a place, continued from those of a database next to it."""
    nearest = nearest_numbers(database, continuation, place)[:_STARTS]
    states = (continuation.reached(state_of(database, continuation, number), place) for number in nearest)
    return next((state for state in states if state is not None), None)


def further_states(
    database: MembraneDatabase,
    continuation: Continuation,
    places: Floats,
    *,
    folder: str | os.PathLike[str],
    way: Way = from_the_nearest,
    again: bool = False,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> list[ScatteredState | None]:
    """Compute the states at further places (n, 6) from those of a database, the lost ones `again`; keep them."""
    # Other runs may keep theirs in the folder at the same time. Again: from the nearest of those that were found.
    store = Store.open(folder, continuation.settings)
    tasks = [partial(_further, way, place) for place in places]
    bar = progress_bar(len(places), "states", show=progress, count=partial(_ended, store, places))
    with keeping(Path(folder)), bar:
        states = run_tasks(tasks, scheduler, workers, continuation, store, database)
        return _lost_ones_again(continuation, store, places, states, scheduler, workers) if again else states


def _further(
    way: Way, place: Floats, continuation: Continuation, store: Store, database: MembraneDatabase
) -> ScatteredState | None:
    return kept_state(store, _name(place), lambda: way(database, continuation, place))


def kept_states(folder: str | os.PathLike[str], continuation: Continuation) -> list[ScatteredState]:
    """Return the states that are kept in a folder."""
    store = Store.open(folder, continuation.settings)
    states = (_stored(store, name) for name in sorted(store.names("state-*")))
    return [state for state in states if state is not None]


def nearest_numbers(database: MembraneDatabase, continuation: Continuation, place: Floats) -> list[int]:
    """Return the numbers of the states of a database, from near a place (6,) to far."""
    away = np.linalg.norm(continuation.places(database["values"]) - place, axis=1)
    return np.argsort(away).tolist()


def state_of(database: MembraneDatabase, continuation: Continuation, number: int) -> ScatteredState:
    """Return a state of a database by its number, on the mesh of a continuation."""
    guess = guess_of(database, continuation, number)
    return continuation.with_derivatives(guess.place, guess.unknowns)


def guess_of(database: MembraneDatabase, continuation: Continuation, number: int) -> ScatteredState:
    """Return what a state of a database is on the mesh of a continuation but for the error of the mesh."""
    # What its modes leave out bends the membrane: with the forces of it, Newton's method needs more steps or fails.
    shape = database["mesh_mean"] + database["mesh"][number] @ database["mesh_modes"]
    if continuation.settings["refinement"] != database.settings["refinement"]:
        coarse = continuation_of(database).simulator.problem.mesh
        shape = prolonged(shape, coarse, continuation.simulator.problem.mesh)
    unknowns = np.append(shape, [database["numbers"][number, 2], database["slack"][number]])
    place = continuation.places(database["values"][number, None])[0]
    return continuation.smoothed(ScatteredState(place, unknowns, np.zeros((len(unknowns), len(place)))))


def continuation_of(database: MembraneDatabase) -> Continuation:
    """Return the continuation on the mesh of a database."""
    return membrane_continuation(database.cross_section, int(database.settings["refinement"]))
