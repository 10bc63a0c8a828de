"""Simulate capsules with random membranes, one by one, and store them in ``data/pools``.

Run ``python -m evidence.benchmarks.membrane_pools KIND FOLDER``. Each solve starts from the nearest state of the
shipped database, or from the nearest capsule of the same batch. Each finished capsule is kept in FOLDER, so that an
interrupted run resumes; what has ended is then stored, without the unfinished batches. The mesh is of refinement 12, of
every tenth capsule or batch 16; no place is one of the states.

Capsules have the default priors of the membrane, and ln Ca and a/l uniform where states are sought.

The capsules of a batch share a membrane drawn from these priors. Their moduli are log-normal with a spread of 10 to
20 %, their radii normal with one of 5 to 8 %; a quarter of them flows at each of four flow rates, which are spread
over up to a factor of five in Ca. A capsule outside the range where states are sought, or without a steady shape, is
drawn anew: these are batches of capsules that are seen. Inflated ones are batches in which the pre-inflation differs
from capsule to capsule, log-normal with a spread of 20 to 40 %.

Others obey laws that are no members of the general one; their places follow Sobol's sequence, and each is reached from
the others.

Meshes are batches of sixteen, each of whose capsules is simulated at refinement 8, 12 and 16.

Pairs differ from the membrane of the plain databases in two of its parameters. Their mesh is that of these databases,
of refinement 12.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain, combinations, islice
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import __version__
from capsbayes.arrays import Floats
from capsbayes.membrane_database import (
    FREE_PARAMETERS,
    NULL_VALUES,
    RANGES,
    MembraneDatabase,
    covered,
    highest_ca,
    lowest_ca,
)
from capsbayes.physics.membrane import EvansSkalak, GeneralisedHooke, InvariantDerivatives, MembraneLaw
from capsbayes.physics.scattered import (
    Continuation,
    ScatteredState,
    from_near_to_far,
    in_modes,
    membrane_continuation,
    scattered_states,
    state_of,
)
from capsbayes.run import Store
from evidence.benchmarks.stored import POOL_FOLDER, arguments, complete
from evidence.rebuild import sobol_places

CAPSULES, MEMBERS = 200, 40
BATCHES = {"batches": 40, "inflated": 6}
FLOW_RATES = np.array([1.0, 1.7, 3.0, 5.0])
MODULUS_SPREADS, RADIUS_SPREADS, MEAN_SIZES = (0.1, 0.2), (0.05, 0.08), (0.84, 1.0)
INFLATION_SPREADS, INFLATIONS = (0.2, 0.4), (0.02, 0.06)  # of inflated batches, with their medians
MARGIN = 1.2  # of Ca between the limits and the mean capsule at the lowest and the highest flow rate
TRIED = 3  # starts from which a capsule is sought, and capsules without a steady shape that are drawn anew
OMITTED = 2e-5  # [l] rms of the outlines, in modes that are left out
LOGARITHMIC = (0, 3, 5)  # of the parameters
OF_SOME = (
    *("law", "batch", "flow", "flow_factor"),
    *("relative_modulus", "relative_radius", "modulus_spread", "radius_spread"),
    *("relative_inflation", "inflation_spread", "refinement"),
)
OF_EACH = 20  # capsules of each of `OTHER_LAWS`
OF_THE_LAW = ("area_dilation_modulus", "strain_hardening")
USUAL, FINE, EVERY = 12, 16, 10  # refinements, and one in how many is of the finer
MESHES = (8, 12, 16)
OF_MESHES = (  # parameters of the mean capsule at the lowest flow rate of batches that are simulated on all of them
    (0.03, 0.92, 0.01, 4.0, 0.3, 1e-4),
    (0.035, 0.88, 0.02, 2.5, 0.6, 3e-4),
    (0.03, 0.95, 0.03, 3.0, 0.0, 5e-4),
)
FEW = 16  # capsules of each of these
PAIRS = 71
OF_PAIRS = ((0.02, 0.2), (0.78, 1.02), (0.005, 0.05), (1.0, 5.0), (0.1, 1.0), (5e-5, 1e-3))  # ranges as `RANGES`
NEAR_THE_END = 1.03  # highest Ca over that of a pair at most
SEED = 2024


@dataclass(frozen=True)
class MooneyRivlin(MembraneLaw):
    """Incompressible sheet, W = [psi (I1 + 2 + 1/(I2 + 1)) + (1 - psi) ((I1 + 2)/(I2 + 1) + I2 + 1) - 3]/2."""

    name: ClassVar[str] = "Mooney-Rivlin"
    area_dilation_modulus: ClassVar[float] = 3.0
    psi: float = 0.7

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        a, b, thinning = self.psi / 2.0, (1.0 - self.psi) / 2.0, 1.0 / (i2 + 1.0)
        stretched = i1 + 2.0
        return (
            a * (stretched + thinning - 3.0) + b * (stretched * thinning + i2 - 2.0),
            a + b * thinning,
            -a * thinning**2 + b * (1.0 - stretched * thinning**2),
            np.zeros_like(thinning),
            -b * thinning**2,
            2.0 * (a + b * stretched) * thinning**3,
        )


@dataclass(frozen=True)
class Ogden(MembraneLaw):
    """Incompressible sheet with exponent four, W = (l1^4 + l2^4 + (l1 l2)^-4 - 3)/8."""

    name: ClassVar[str] = "Ogden"
    area_dilation_modulus: ClassVar[float] = 3.0

    def derivatives(self, i1: Floats, i2: Floats) -> InvariantDerivatives:
        thinning, stretched = 1.0 / (i2 + 1.0), i1 + 2.0
        one = np.ones_like(thinning)
        return (
            (stretched**2 - 2.0 / thinning + thinning**2 - 3.0) / 8.0,
            stretched / 4.0,
            -(1.0 + thinning**3) / 4.0,
            one / 4.0,
            0.0 * one,
            0.75 * thinning**4,
        )


OTHER_LAWS: dict[str, MembraneLaw] = {
    "generalised Hooke": GeneralisedHooke(0.5),
    "Evans-Skalak": EvansSkalak(3.0),
    "Mooney-Rivlin": MooneyRivlin(),
    "Ogden": Ogden(),
}


def pool_of(name: str) -> Path:
    """Return where a pool is stored."""
    return POOL_FOLDER / f"membrane-{name}.npz"


def stored(name: str) -> dict[str, Any]:
    """Return a pool: arrays by name, one row a capsule; the outlines (n, p, 2) [l] in double precision.

    ``values`` (n, 6) are the parameters in the order of `FREE_PARAMETERS`, ``numbers`` (n, 4) are `NUMBERS`,
    ``profile`` and ``silhouette`` the outlines. Of batches further ``batch`` (n,), ``flow`` (n,), the number of the
    flow rate, ``flow_factor`` (n,), its velocity over the lowest of the batch, ``relative_modulus`` and
    ``relative_radius`` (n,), over the median and the mean of the batch, and ``modulus_spread`` and ``radius_spread``
    (n,) of the batch, and ``relative_inflation`` and ``inflation_spread`` (n,) likewise; of others ``law`` (n,), the
    number of that of `OTHER_LAWS`, and no strain hardening.
    ``not_reached`` (k, 6) are capsules for which no steady shape was found.
    """
    with np.load(pool_of(name)) as file:
        arrays = {key: np.asarray(value, np.float64) for key, value in file.items() if key != "settings"}
    for view in ("profile", "silhouette"):
        flat = arrays.pop(f"{view}_mean") + arrays[view] @ arrays.pop(f"{view}_modes")
        arrays[view] = flat.reshape(len(flat), -1, 2)
    return arrays


def drawn_values(random: np.random.Generator) -> Floats:
    """Draw the parameters (6,) where states are sought."""
    while True:
        values = between(RANGES, random.random(len(RANGES)))
        if covered(values[None])[0]:
            return values


def between(ranges: Sequence[tuple[float, float]], shares: Floats) -> Floats:
    """Return the values (6,) at shares of ranges, of some in the logarithm."""
    return np.array(
        [
            low * (high / low) ** share if axis in LOGARITHMIC else low + (high - low) * share
            for axis, ((low, high), share) in enumerate(zip(ranges, shares, strict=True))
        ]
    )


class Starts:
    """States from which others are reached: those of the shipped database, and what was found since."""

    def __init__(self, continuation: Continuation) -> None:
        self.continuation, self.database = continuation, MembraneDatabase.open("square")
        self.shipped = continuation.places(self.database["values"])
        self.found: list[ScatteredState] = []

    def nearest(self, place: Floats) -> Iterator[ScatteredState]:
        """Yield the nearest states to a place (6,)."""
        places = np.concatenate([self.shipped, *(state.place[None] for state in self.found)])
        for number in np.argsort(np.linalg.norm(places - place, axis=1))[:TRIED]:
            since = int(number) - len(self.shipped)
            yield self.found[since] if since >= 0 else state_of(self.database, self.continuation, int(number))

    def reached(self, place: Floats, *, derivatives: bool) -> ScatteredState | None:
        """Return the state at a place (6,) from one of the nearest states, or None."""
        ends = (self.continuation.reached(near, place, derivatives=derivatives) for near in self.nearest(place))
        return next((state for state in ends if state is not None), None)


def drawn_capsule(number: int) -> Floats:
    """Draw the parameters (6,) of a single capsule."""
    return drawn_values(np.random.default_rng([SEED, 0, number]))


def refinement_of(number: int) -> int:
    """Return the refinement of the mesh of a capsule or batch."""
    return FINE if number % EVERY == EVERY - 1 else USUAL


def simulate_singles(
    store: Store, continuation: Continuation, name: str, numbers: Iterable[int], drawn: Callable[[int], Floats]
) -> None:
    """Simulate the single capsules that the store lacks."""
    starts = Starts(continuation)

    def simulated(number: int) -> dict[str, Any]:
        values = drawn(number)
        state = starts.reached(continuation.places(values[None])[0], derivatives=False)
        seen = {} if state is None else continuation.seen(state)
        return {"values": values, "reached": state is not None, "refinement": _refinement(continuation), **seen}

    complete(store, ((f"{name}-{number:03d}", partial(simulated, number)) for number in numbers))


def _refinement(continuation: Continuation) -> float:
    return float(continuation.simulator.refinement)


class Batch(NamedTuple):
    """Membrane, flow rates and population of a batch."""

    number: int
    values: Floats
    factors: Floats
    modulus_spread: float
    radius_spread: float
    inflation_spread: float = 0.0

    @classmethod
    def of_meshes(cls, number: int) -> Batch:
        """Return one of `OF_MESHES`."""
        return cls(number, np.array(OF_MESHES[number]), FLOW_RATES ** (np.log(2.5) / np.log(5.0)), 0.12, 0.05)

    @classmethod
    def drawn(cls, number: int, *, inflated: bool = False) -> Batch:
        """Draw a batch; its values are those of the mean capsule at the lowest flow rate."""
        random = np.random.default_rng([SEED, 3 if inflated else 1, number])
        values = drawn_values(random)
        if inflated:
            values[2] = random.uniform(*INFLATIONS)
        values[1] = random.uniform(*MEAN_SIZES)
        low, high = lowest_ca(values[2]) * MARGIN, highest_ca(values[1], values[4]) / MARGIN
        factors = FLOW_RATES ** min(1.0, np.log(high / low) / np.log(FLOW_RATES[-1]))
        values[0] = low * (high / (low * factors[-1])) ** random.random()
        spreads = [random.uniform(*MODULUS_SPREADS), random.uniform(*RADIUS_SPREADS)]
        return cls(number, values, factors, *spreads, random.uniform(*INFLATION_SPREADS) if inflated else 0.0)

    def capsules(self, member: int) -> Iterator[tuple[Floats, dict[str, float]]]:
        """Yield candidates for one capsule that lie where states are sought, with what is stored of them."""
        random, flow = np.random.default_rng([SEED, 2, self.number, member]), member % len(self.factors)
        while True:
            modulus = float(np.exp(self.modulus_spread * random.standard_normal()))
            radius = 1.0 + self.radius_spread * float(random.standard_normal())
            values = self.values.copy()
            varied = self.inflation_spread * random.standard_normal() if self.inflation_spread else 0.0
            inflation = float(np.exp(varied))
            values[:3] *= self.factors[flow] / modulus, radius, inflation
            if covered(values[None])[0]:
                of_it = {"flow_factor": float(self.factors[flow]), "modulus_spread": self.modulus_spread}
                of_it |= {"relative_modulus": modulus, "relative_radius": radius, "radius_spread": self.radius_spread}
                of_it |= {"relative_inflation": inflation, "inflation_spread": self.inflation_spread}
                yield values, {"batch": float(self.number), "flow": float(flow), **of_it}


def simulate_batch(store: Store, continuation: Continuation, batch: Batch, count: int) -> None:
    """Simulate the capsules of a batch that the store lacks, each from the nearest state or capsule."""
    members = [batch.capsules(member) for member in range(count)]
    firsts = [next(candidates) for candidates in members]
    places = continuation.places(np.array([values for values, _ in firsts]))
    starts = Starts(continuation)
    for member in from_near_to_far(places.mean(axis=0), places):
        name = f"batch-{batch.number:02d}-capsule-{member:02d}"
        part = store.load(name)
        if part is None:
            part = simulated_member(starts, chain([firsts[member]], members[member]))
            store.save(name, part)
        if part["reached"]:
            starts.found.append(ScatteredState(**{field.name: part[field.name] for field in fields(ScatteredState)}))


def simulated_member(starts: Starts, candidates: Iterator[tuple[Floats, dict[str, float]]]) -> dict[str, Any]:
    """Simulate the first candidate that has a steady shape."""
    lost: list[Floats] = []
    continuation = starts.continuation
    for values, of_it in islice(candidates, TRIED):
        state = starts.reached(continuation.places(values[None])[0], derivatives=True)
        if state is not None:
            of_state = {field.name: getattr(state, field.name) for field in fields(state)}
            found = {"values": values, "lost": np.array(lost).reshape(-1, len(values))}
            found["refinement"] = _refinement(continuation)
            return {"reached": True, **found, **of_it, **of_state, **continuation.seen(state)}
        lost.append(values)
    return {"reached": False, "lost": np.array(lost)}


def drawn_pair(number: int) -> Floats:
    """Draw the parameters (6,) of a pair; which two differ from those of the plain ones changes with the number."""
    random = np.random.default_rng([SEED, 3, number])
    pairs = tuple(combinations(range(2, len(FREE_PARAMETERS)), 2))
    free = [0, 1, *pairs[number % len(pairs)]]
    while True:
        values = np.array(NULL_VALUES)
        values[free] = between(OF_PAIRS, random.random(len(FREE_PARAMETERS)))[free]
        if covered((values * [NEAR_THE_END, 1.0, 1.0, 1.0, 1.0, 1.0])[None])[0]:
            return values


def simulate_others(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Simulate the capsules of other laws that the folder lacks, and return all of them by law."""
    general, found = membrane_continuation("square", USUAL), {}
    for name, law in OTHER_LAWS.items():
        axes = tuple(axis for axis in general.axes if axis.name not in OF_THE_LAW)
        continuation = Continuation(replace(general.simulator, law=law), axes)
        points = sobol_places(OF_EACH, len(axes))
        values = continuation.values(points)
        low, high = lowest_ca(values[:, 2]), highest_ca(values[:, 1], 0.0)
        values[:, 0] = low * (high / low) ** points[:, 0]
        start = continuation.taken(continuation.simulator.run(capillary_number=0.06, size_ratio=0.9))
        states = scattered_states(
            continuation, start, continuation.places(values), folder=folder / name, scheduler="synchronous"
        )
        values = np.insert(values, 3, [[law.area_dilation_modulus], [np.nan]], axis=1)
        found[name] = [
            {"reached": state is not None, "values": row, **({} if state is None else continuation.seen(state))}
            for row, state in zip(values, states, strict=True)
        ]
    return found


def finished(store: Store, members: int) -> list[dict[str, Any]]:
    """Return what has ended of the capsules of a folder; of batches those that have all their members."""
    parts = {name: part for name in sorted(store.names()) if (part := store.load(name)) is not None}
    of_batch = Counter(name[:8] for name in parts)
    return [part for name, part in parts.items() if not members or of_batch[name[:8]] == members]


def write(kind: str, parts: list[dict[str, Any]], settings: Mapping[str, object]) -> None:
    """Store the capsules that were reached, the parameters of those that were not, and the settings."""
    seen = [part for part in parts if part["reached"]]
    if not seen:
        return
    lost = [part["values"] for part in parts if not part["reached"] and "values" in part]
    lost += [values for part in parts for values in part.get("lost", ())]
    columns: dict[str, Any] = {"not_reached": np.array(lost).reshape(-1, len(RANGES))}
    columns["settings"] = np.array(json.dumps(settings | {"version": __version__}))
    for key in ("values", "numbers", *OF_SOME):
        if all(key in part for part in seen):
            columns[key] = np.array([part[key] for part in seen])
    for view in ("profile", "silhouette"):
        modes = in_modes(np.array([part[view] for part in seen]), OMITTED)
        of_view = {f"{view}_mean": modes.mean, f"{view}_modes": modes.modes, view: modes.coefficients}
        columns |= {key: array.astype(np.float32) for key, array in of_view.items()}
    path = pool_of(kind)
    np.savez_compressed(path, **columns)
    print(f"{len(seen)} capsules in {path.name}, {path.stat().st_size} bytes; {len(lost)} not reached")


def simulate(kind: str, store: Store, continuation: Continuation, numbers: Sequence[int]) -> None:
    """Simulate capsules or batches of a kind, by their numbers, that the store lacks."""
    if kind == "pairs":
        simulate_singles(store, continuation, "pair", numbers, drawn_pair)
    elif kind == "capsules":
        simulate_singles(store, continuation, "capsule", numbers, drawn_capsule)
    else:
        for number in numbers:
            given = kind == "meshes"
            batch = Batch.of_meshes(number) if given else Batch.drawn(number, inflated=kind == "inflated")
            simulate_batch(store, continuation, batch, FEW if given else MEMBERS)


def numbers_of(kind: str) -> dict[int, list[int]]:
    """Return the numbers of the capsules or batches of a kind, by the refinement of their meshes."""
    if kind == "meshes":
        return {refinement: list(range(len(OF_MESHES))) for refinement in MESHES}
    if kind == "pairs":
        return {USUAL: list(range(PAIRS))}
    every = range(BATCHES.get(kind, CAPSULES))
    return {mesh: [number for number in every if refinement_of(number) == mesh] for mesh in (USUAL, FINE)}


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("kind", choices=("capsules", *BATCHES, "others", "pairs", "meshes"))
    parser.add_argument("folder", type=Path, help="where finished capsules are kept")
    given = parser.parse_args()
    settings = membrane_continuation("square", USUAL).settings
    if given.kind == "others":
        numbered = list(enumerate(simulate_others(given.folder).values()))
        laws = {"law": [law.name for law in OTHER_LAWS.values()]}
        parts = [{**part, "law": float(number)} for number, of_law in numbered for part in of_law]
        write("others", parts, settings | laws)
        return
    members = {"meshes": FEW}.get(given.kind, MEMBERS if given.kind in BATCHES else 0)
    parts = []
    try:
        for refinement, numbers in numbers_of(given.kind).items():
            continuation = membrane_continuation("square", refinement)
            store = Store.open(given.folder / f"refinement-{refinement}", continuation.settings)
            try:
                with threadpool_limits(limits=1):
                    simulate(given.kind, store, continuation, numbers)
            finally:
                parts += finished(store, members)
    finally:
        write(given.kind, parts, settings)


if __name__ == "__main__":
    main()
