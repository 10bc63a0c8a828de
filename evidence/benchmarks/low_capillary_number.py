"""Shapes at low Ca: which exist, which are stable, and which one a capsule started from rest reaches.

``python -m evidence.benchmarks.low_capillary_number`` traces the branches and follows capsules from rest. The results
are kept in ``evidence/results/low-capillary-number.json``; run again, it computes only what is missing, with ``--page``
nothing. ``--write`` renews the tables in ``evidence/results/low-capillary-number.md`` and its pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from capsbayes import Database, Simulator
from capsbayes.physics.continuation import fold, is_shallow, near_rest, parachute, settled, traced
from capsbayes.physics.load import profile
from capsbayes.physics.steady import Iterate, Problem, steady_state
from capsbayes.physics.transient import growth_rates, transient
from evidence.benchmarks.stored import RESULTS, Stored, with_write
from evidence.markdown import table

FINE, COARSE = 12, 8
BENDING = 2e-4
BRANCH_SIZES = (0.75, 0.9, 1.1)
HIGHEST, LOWEST = 0.03, 0.002
POINTS = 24  # of a branch, at most
MESHES, MESH_SIZE, MESH_RANGE, BRACKET = (6, 8, 10, 12, 16), 0.85, (0.005, 0.02), 1.06
BENDINGS, BENT_SIZES = (5e-5, 2e-4, 1e-3, 3e-3), (0.75, 0.9)
BENT_CA = (0.003, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.02, 0.03)
EXACT = (  # refinement, a/l, Ca
    *((COARSE, size, ca) for size in (0.75, 0.9) for ca in (0.0075, 0.01, 0.02)),
    *((FINE, size, ca) for size, ca in ((0.75, 0.01), (0.85, 0.0075), (0.9, 0.005), (0.9, 0.0075), (0.9, 0.01))),
)
EXACT_UNTIL = 6.0  # U t / l
TICKS = (0.003, 0.005, 0.01, 0.02, 0.03)
LENGTHS = ("axial_extent", "axial_length")
State = dict[str, float]
Results = dict[str, list[State]]


def measured(problem: Problem, iterate: Iterate) -> State:
    """Return lengths over l, velocity over U, and the growth rate of small symmetric disturbances."""
    outline = profile(problem.mesh, problem.mesh.expanded(iterate.free))
    return {
        "ca": iterate.capillary_number,
        "axial_extent": outline.axial_extent,
        "axial_length": outline.axial_length,
        "velocity_ratio": float(iterate.velocity),
        "slack": float(iterate.slack),
        "growth": float(growth_rates(problem, iterate)[0].real),
        "tension": float(problem.membrane(iterate.size_ratio).principal_tensions(iterate.free).min()),
    }


def branch(kind: str, size: float) -> list[State]:
    """Return the states of a branch on the fine mesh: upward from rest to its end, or downward for the parachutes."""
    problem, rising = Simulator(refinement=FINE, bending=BENDING).problem, kind == "rest"
    start = near_rest(problem, size) if rising else parachute(problem, HIGHEST, size)
    states: list[State] = []
    before = None
    for point in traced(problem, start.result, rising=rising):
        if before is not None and before.rising != point.rising:
            return [*states, measured(problem, fold(problem, before, point).result.iterate) | {"fold": 1.0}]
        states.append(measured(problem, point.result.iterate))
        if not LOWEST < states[-1]["ca"] < HIGHEST * 1.01 or len(states) == POINTS:
            return states
        before = point
    return states


def from_rest(problem: Problem, ca: float, size: float) -> list[State]:
    """Return the steady state that a capsule from rest reaches, or nothing."""
    steady = settled(problem, ca, size)
    return [] if steady is None else [measured(problem, steady.iterate)]


def snap_through(refinement: int) -> list[State]:
    """Return two Ca on either side of the snap-through of a capsule from rest, as close as BRACKET."""
    problem, (low, high) = Simulator(refinement=refinement, bending=BENDING).problem, MESH_RANGE
    while high > BRACKET * low:
        ca = (low * high) ** 0.5
        steady = settled(problem, ca, MESH_SIZE)
        convex = steady is None or is_shallow(problem, steady.iterate)
        low, high = (ca, high) if convex else (low, ca)
    return [{"low": low, "high": high}]


def exact(refinement: int, size: float, ca: float) -> list[State]:
    """Return the end of a transient with a small tolerance, and that of large implicit steps."""
    problem = Simulator(refinement=refinement, bending=BENDING).problem
    *_, end = transient(problem, problem.at_rest(ca, size), [EXACT_UNTIL], steady=1e-3)
    return [measured(problem, steady_state(problem, end.iterate).iterate), *from_rest(problem, ca, size)]


def tasks() -> Iterator[tuple[str, Callable[[], list[State]]]]:
    """Yield the name and the function of everything to compute, the cheapest first."""
    for case in EXACT:
        yield "exact {} {} {}".format(*case), partial(exact, *case)
    for bending in BENDINGS:
        problem = Simulator(refinement=COARSE, bending=bending).problem
        for size in BENT_SIZES:
            for ca in BENT_CA:
                yield f"bending {bending} {size} {ca}", partial(from_rest, problem, ca, size)
    for size in BRANCH_SIZES:
        for kind in ("rest", "parachute"):
            yield f"{kind} {size}", partial(branch, kind, size)
    for refinement in MESHES:
        yield f"mesh {refinement}", partial(snap_through, refinement)


def rounded(task: Callable[[], list[State]]) -> list[State]:
    """Return the states of a task with six digits, which are stored."""
    return [{key: float(f"{value:.6g}") for key, value in state.items()} for state in task()]


def shipped_rows(database: Database, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Ca, L_z/2a and L_a/2a of one sweep of a database, below HIGHEST."""
    cases = database.converged
    here = (np.abs(cases["size_ratio"] - size) < 1e-6) & (cases["capillary_number"] < 1.01 * HIGHEST)
    lengths = (cases[quantity][here] / (2 * size) for quantity in LENGTHS)
    return cases["capillary_number"][here], *lengths


def finish(axis, size: float) -> None:
    """Set title and scales of one panel."""
    axis.set(title=f"a/l = {size:g}", xscale="log", xlim=(LOWEST, 1.1 * HIGHEST), xlabel="Ca")
    axis.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axis.xaxis.set_minor_formatter("")


def draw_branches(known: Results) -> Figure:
    """Draw the branches on the fine mesh, with the rows of the database."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    axes = figure.subplots(1, len(BRANCH_SIZES))
    database = Database.open("square-neo-hookean")
    for axis, size in zip(axes, BRANCH_SIZES, strict=True):
        for kind, colour, text in (("rest", "#0072b2", "from rest"), ("parachute", "#d55e00", "parachutes")):
            states = known.get(f"{kind} {size}", [])
            ca = np.array([state["ca"] for state in states])
            stable = np.array([state["growth"] < 0 for state in states], dtype=bool)
            for quantity, line in zip(LENGTHS, ("-", "--"), strict=True):
                length = np.array([state[quantity] for state in states]) / (2 * size)
                axis.plot(ca, length, line, color=colour, linewidth=1, label=text if line == "-" else None)
                axis.plot(ca[~stable], length[~stable], "o", color=colour, markerfacecolor="white", markersize=4)
        ca, extent, length = shipped_rows(database, size)
        axis.plot(ca, extent, "k+", markersize=9, label="database")
        axis.plot(ca, length, "kx", markersize=7)
        finish(axis, size)
    axes[0].set_ylabel("L_z / 2a (full, +), L_a / 2a (dashed, x)")
    axes[0].legend(fontsize=8, loc="lower left")
    return figure


def curves(axis, colour, label: str, ca, extent, length) -> None:
    """Draw L_z/2a and L_a/2a over Ca."""
    axis.plot(ca, extent, "o-", color=colour, linewidth=0.8, markersize=4, label=label)
    axis.plot(ca, length, "x--", color=colour, linewidth=0.8, markersize=4)


def draw_settings(known: Results) -> Figure:
    """Draw how bending and pre-inflation change the shapes from rest."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    axes = figure.subplots(2, 2, sharey=True)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, 5))
    inflated = Database.open("square-pre-inflation")
    for column, size in enumerate(BENT_SIZES):
        axis = axes[0, column]
        for bending, colour in zip(BENDINGS, colours, strict=False):
            states = [state for ca in BENT_CA for state in known.get(f"bending {bending} {size} {ca}", [])]
            lengths = ([state[quantity] / (2 * size) for state in states] for quantity in LENGTHS)
            curves(axis, colour, f"B = {bending:g}", [state["ca"] for state in states], *lengths)
        finish(axis, size)
        axis = axes[1, column]
        for value, colour in zip(inflated.values, colours, strict=True):
            curves(axis, colour, f"alpha = {value:g}", *shipped_rows(inflated.at_value(float(value)), size))
        finish(axis, size)
    for axis in axes[:, 0]:
        axis.set_ylabel("L_z / 2a (o), L_a / 2a (x)")
        axis.legend(fontsize=8)
    return figure


def snap_rows() -> Iterator[list[str]]:
    """Yield the last convex case and the first parachute of each sweep of the database with a snap-through."""
    database = Database.open("square-neo-hookean")
    cases = database.converged
    borders = [database[f"border_{name}"] for name in ("size_ratio", "capillary_number", "kind")]
    for size, ca, kind in zip(*borders, strict=True):
        if kind == "snap-through":
            column = np.flatnonzero(np.abs(cases["size_ratio"] - size) < 1e-6)
            column = column[np.argsort(cases["capillary_number"][column])]
            after = int(np.searchsorted(cases["capillary_number"][column], ca))
            ends = column[after - 1 : after + 1]
            last, first = cases["capillary_number"][ends]
            lengths = cases["axial_extent"][ends] / (2 * size)
            tension = cases["minimum_tension"][ends[0]]
            yield [f"{size:g}", f"{last:.4g} to {first:.4g}", f"{tension:.3f}", *map("{:.4f}".format, lengths)]


def snap_by_inflation() -> str:
    """Return the table of the Ca of the snap-through by inflation and size."""
    database = Database.open("square-pre-inflation")
    sizes = sorted(set(np.round(database["border_size_ratio"], 6)))
    rows = []
    for value in database.values:
        of_value = database.at_value(float(value))
        kinds, places, ends = (of_value[f"border_{name}"] for name in ("kind", "size_ratio", "capillary_number"))
        snap_through_ca = {
            round(float(place), 6): f"{end:.3g}"
            for kind, place, end in zip(kinds, places, ends, strict=True)
            if kind in ("snap-through", "lost from rest")
        }
        rows.append([f"{value:g}", *(snap_through_ca.get(size, "-") for size in sizes)])
    return table(("alpha", *(f"a/l {size:g}" for size in sizes)), rows)


def transient_rows(known: Results) -> Iterator[list[str]]:
    """Yield the shapes at the end of a transient, and of long implicit steps."""
    for case in EXACT:
        states = known.get("exact {} {} {}".format(*case), [])
        if len(states) == 2:
            extents = [f"{state['axial_extent']:.4f}" for state in states]
            growth = ", ".join(f"{state['growth']:.2f}" for state in states)
            yield [*map(str, case), *extents, growth, ", ".join(dict.fromkeys(map(_shape, states)))]


def _shape(state: State) -> str:
    """Return the name of a shape by the depth of its rear."""
    return "parachute" if state["axial_extent"] - state["axial_length"] > 0.02 else "convex"


def tables(known: Results) -> dict[str, str]:
    """Return the tables of the page."""
    last = {size: known[f"parachute {size}"][-1] for size in BRANCH_SIZES if known.get(f"parachute {size}")}
    ends = [[f"{size:g}", f"{'' if 'fold' in state else 'below '}{state['ca']:.4f}"] for size, state in last.items()]
    meshes = [
        [str(refinement), f"{state['low']:.4f}", f"{state['high']:.4f}"]
        for refinement in MESHES
        for state in known.get(f"mesh {refinement}", [])
    ]
    of_snap = ("a/l", "Ca", "smallest tension before, G_s", "L_z/2a before", "L_z/2a after")
    of_transients = ("refinement", "a/l", "Ca", "L_z/l, at once", "L_z/l, long steps")
    of_transients += ("growth rate of either [U/l]", "shapes")
    return {
        "snap-through": table(of_snap, snap_rows()),
        "lower ends": table(("a/l", "lower end of the parachutes, Ca"), ends),
        "meshes": table(("refinement", "convex up to Ca", "parachute from Ca"), meshes),
        "inflation": snap_by_inflation(),
        "transients": table(of_transients, transient_rows(known)),
    }


STORED = Stored("low-capillary-number.json", "evidence/results/low-capillary-number.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("--page", action="store_true", help="compute nothing")
    given = parser.parse_args()
    missing = () if given.page else ((name, partial(rounded, task)) for name, task in tasks())
    known = STORED.completed(missing)
    STORED.show(known, write=given.write)
    if given.write:
        for name, draw in (("branches", draw_branches), ("settings", draw_settings)):
            draw(known).savefig(RESULTS / "pictures" / f"low-{name}.png", dpi=110)


if __name__ == "__main__":
    main()
