"""Shapes at low Ca: which exist, which are stable, and which one a capsule started from rest reaches.

``python evidence/low_capillary_number.py`` traces the branches, follows capsules from rest, and writes the page
``evidence/results/low-capillary-number.md`` with its pictures. The results are kept in
``evidence/results/low-capillary-number.json``; run again, the script computes only what is missing. With ``--page`` it
computes nothing and writes the page of the stored results; with a word such as ``exact`` it computes the results whose
name begins with it.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import Database, Simulator
from capsbayes.physics.continuation import fold, is_shallow, near_rest, parachute, settled, traced
from capsbayes.physics.load import profile
from capsbayes.physics.steady import Iterate, Problem, steady_state
from capsbayes.physics.transient import growth_rates, transient

matplotlib.use("agg")
import matplotlib.pyplot as plt

RESULTS = Path(__file__).parent / "results"
STORE = RESULTS / "low-capillary-number.json"
PAGE = RESULTS / "low-capillary-number.md"
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


def compute(only_page: bool, wanted: str) -> Results:
    """Return the stored results; unless `only_page`, compute the missing ones whose name begins with `wanted`."""
    known: Results = json.loads(STORE.read_text()) if STORE.exists() else {}
    if only_page:
        return known
    with ProcessPoolExecutor(initializer=threadpool_limits, initargs=(1,)) as pool:
        missing = {pool.submit(task): name for name, task in tasks() if name not in known and name.startswith(wanted)}
        for done in as_completed(missing):
            name = missing[done]
            known[name] = [{key: float(f"{value:.6g}") for key, value in state.items()} for state in done.result()]
            partial_file = STORE.with_suffix(".tmp")
            partial_file.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n")
            os.replace(partial_file, STORE)
            print(name, len(known[name]), file=sys.stderr, flush=True)
    return known


def shipped_rows(database: Database, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Ca, L_z/2a and L_a/2a of one sweep of a database, below HIGHEST."""
    cases = database.converged
    here = (np.abs(cases["size_ratio"] - size) < 1e-6) & (cases["capillary_number"] < 1.01 * HIGHEST)
    return (
        cases["capillary_number"][here],
        cases["axial_extent"][here] / (2 * size),
        cases["axial_length"][here] / (2 * size),
    )


def finish(axis, size: float) -> None:
    """Set title and scales of one panel."""
    axis.set(title=f"a/l = {size:g}", xscale="log", xlim=(LOWEST, 1.1 * HIGHEST), xlabel="Ca")
    axis.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axis.xaxis.set_minor_formatter("")


def draw_branches(known: Results) -> Path:
    """Draw the branches on the fine mesh, with the rows of the database."""
    figure, axes = plt.subplots(1, len(BRANCH_SIZES), figsize=(11, 4.2), constrained_layout=True)
    database = Database.open("square-neo-hookean")
    for axis, size in zip(axes, BRANCH_SIZES, strict=True):
        for kind, colour, text in (("rest", "#0072b2", "from rest"), ("parachute", "#d55e00", "parachutes")):
            states = known.get(f"{kind} {size}", [])
            ca = np.array([state["ca"] for state in states])
            stable = np.array([state["growth"] < 0 for state in states], dtype=bool)
            for quantity, line in (("axial_extent", "-"), ("axial_length", "--")):
                length = np.array([state[quantity] for state in states]) / (2 * size)
                axis.plot(ca, length, line, color=colour, linewidth=1, label=text if line == "-" else None)
                axis.plot(ca[~stable], length[~stable], "o", color=colour, markerfacecolor="white", markersize=4)
        ca, extent, length = shipped_rows(database, size)
        axis.plot(ca, extent, "k+", markersize=9, label="database")
        axis.plot(ca, length, "kx", markersize=7)
        finish(axis, size)
    axes[0].set_ylabel("L_z / 2a (full, +), L_a / 2a (dashed, x)")
    axes[0].legend(fontsize=8, loc="lower left")
    path = RESULTS / "pictures" / "low-branches.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def draw_settings(known: Results) -> Path:
    """Draw how bending and pre-inflation change the shapes from rest."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 7.5), constrained_layout=True, sharey=True)
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.9, 5))
    inflated = Database.open("square-pre-inflation") if "square-pre-inflation" in Database.shipped() else None
    for column, size in enumerate(BENT_SIZES):
        axis = axes[0, column]
        for bending, colour in zip(BENDINGS, colours, strict=False):
            states = [state for ca in BENT_CA for state in known.get(f"bending {bending} {size} {ca}", [])]
            ca = [state["ca"] for state in states]
            for quantity, line in (("axial_extent", "o-"), ("axial_length", "x--")):
                length = [state[quantity] / (2 * size) for state in states]
                text = f"B = {bending:g}" if line == "o-" else None
                axis.plot(ca, length, line, color=colour, linewidth=0.8, markersize=4, label=text)
        finish(axis, size)
        axis = axes[1, column]
        for value, colour in zip([] if inflated is None else inflated.values, colours, strict=False):
            ca, extent, length = shipped_rows(inflated.at_value(float(value)), size)
            axis.plot(ca, extent, "o-", color=colour, linewidth=0.8, markersize=4, label=f"alpha = {value:g}")
            axis.plot(ca, length, "x--", color=colour, linewidth=0.8, markersize=4)
        finish(axis, size)
    for axis in axes[:, 0]:
        axis.set_ylabel("L_z / 2a (o), L_a / 2a (x)")
        if axis.lines:
            axis.legend(fontsize=8)
    path = RESULTS / "pictures" / "low-settings.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def snap_rows() -> list[str]:
    """Return a table row for each sweep of the database with a snap-through."""
    database = Database.open("square-neo-hookean")
    cases, rows = database.converged, []
    for size, ca, kind in zip(
        *(database[f"border_{name}"] for name in ("size_ratio", "capillary_number", "kind")), strict=True
    ):
        if kind != "snap-through":
            continue
        column = np.flatnonzero(np.abs(cases["size_ratio"] - size) < 1e-6)
        column = column[np.argsort(cases["capillary_number"][column])]
        after = int(np.searchsorted(cases["capillary_number"][column], ca))
        last, first = column[after - 1], column[after]
        lengths = [cases["axial_extent"][row] / (2 * size) for row in (last, first)]
        ends = [cases["capillary_number"][row] for row in (last, first)]
        rows.append(
            f"| {size:g} | {ends[0]:.4g} to {ends[1]:.4g} | {cases['minimum_tension'][last]:.3f} "
            f"| {lengths[0]:.4f} | {lengths[1]:.4f} |"
        )
    return rows


def inflation_rows() -> list[str]:
    """Return the table of the Ca of the snap-through by inflation and size."""
    if "square-pre-inflation" not in Database.shipped():
        return []
    database = Database.open("square-pre-inflation")
    sizes = sorted(set(np.round(database["border_size_ratio"], 6)))
    rows = ["| alpha | " + " | ".join(f"a/l {size:g}" for size in sizes) + " |", "|---" * (len(sizes) + 1) + "|"]
    for value in database.values:
        of_value = database.at_value(float(value))
        kinds, places, ends = (of_value[f"border_{name}"] for name in ("kind", "size_ratio", "capillary_number"))
        snap_through_ca = {
            round(float(place), 6): end
            for kind, place, end in zip(kinds, places, ends, strict=True)
            if kind in ("snap-through", "lost from rest")
        }
        rows.append(
            f"| {value:g} | "
            + " | ".join(f"{snap_through_ca[s]:.3g}" if s in snap_through_ca else "-" for s in sizes)
            + " |"
        )
    return rows


def _shape(state: State) -> str:
    """Return the name of a shape by the depth of its rear."""
    return "parachute" if state["axial_extent"] - state["axial_length"] > 0.02 else "convex"


def page(known: Results) -> str:
    """Return the page, with every number from the store or from the database."""
    buckling = 2 * np.sqrt(3 * BENDING)
    ends = {size: known.get(f"parachute {size}", []) for size in BRANCH_SIZES}
    lines = [
        "# Shapes at low capillary number",
        "",
        "Made by `python evidence/low_capillary_number.py`: square channel, neo-Hookean membrane, bending "
        f"stiffness B = {BENDING:g} G_s a^2 unless stated otherwise.",
        "",
        "A capsule started from rest at a very low Ca keeps a convex rear. Its membrane is compressed there, and a "
        f"sphere buckles at a compressive tension of 2 (3 B)^(1/2) G_s = {buckling:.3f} G_s. Near this tension the "
        "branch of convex shapes ends in a fold or becomes unstable, and the capsule **snaps through** to a "
        "parachute. When Ca is lowered again, the parachute keeps its dimple far below: between the two Ca both "
        "shapes are steady, and stable to disturbances with the symmetry of the channel; the history decides which "
        "one is seen. The databases contain the shape that a capsule started from rest reaches in time, followed with "
        "long implicit steps. Up to the snap-through another shape is stable too, and a capsule that is suddenly set "
        "in motion may jump to it. Those Ca are marked, and the status of a posterior that leans on them says so. "
        "Wide capsules (a/l from 1.075 on) do not snap: their rear turns concave smoothly.",
        "",
        f"![Branches at low Ca](pictures/{draw_branches(known).name})",
        "",
        f"Branches at refinement {FINE}; open circles are unstable states. The rows of the database follow the "
        "branch from rest while it is stable, and the branch of the parachutes after the snap-through. In "
        "between, a capsule may reach a wrinkled convex shape, as at a/l = 0.75, where it is up to 1 % "
        "longer.",
        "",
        "## Where a capsule from rest snaps through",
        "",
        "From the database `square-neo-hookean`: the last convex case and the first parachute of each sweep in Ca.",
        "",
        "| a/l | Ca | smallest tension before, G_s | L_z/2a before | L_z/2a after |",
        "|---|---|---|---|---|",
        *snap_rows(),
        "",
        "Lower end of the branch of parachutes: "
        + "; ".join(
            f"a/l {size:g}: "
            + (f"Ca {states[-1]['ca']:.4f}" if "fold" in states[-1] else f"below {states[-1]['ca']:.4f}")
            for size, states in ends.items()
            if states
        )
        + ".",
        "",
        f"## How it depends on the mesh (a/l = {MESH_SIZE:g})",
        "",
        "| refinement | convex up to Ca | parachute from Ca |",
        "|---|---|---|",
        *(
            f"| {refinement} | {state['low']:.4f} | {state['high']:.4f} |"
            for refinement in MESHES
            for state in known.get(f"mesh {refinement}", [])
        ),
        "",
        "A coarse mesh is too stiff to buckle as early. The Ca has not converged on the finest of these meshes: on a "
        "finer one a capsule may snap through at a still lower Ca. Between the snap-through of the membrane and that "
        "of their mesh the coarse databases contain convex shapes; their marks extend up to their own snap-through.",
        "",
        "## What bending and pre-inflation change",
        "",
        f"![Bending and pre-inflation](pictures/{draw_settings(known).name})",
        "",
        f"Shapes reached from rest at refinement {COARSE}, those of the inflated capsules at 10. A stiffer "
        f"membrane stays convex up to a higher Ca. With B = {BENDINGS[0]:g} the wrinkles are too short for "
        "this mesh, and the shape that a capsule reaches changes from one Ca to the next. Pre-inflation puts "
        "the membrane under tension: the snap-through moves to a higher Ca, until in wide capsules the rear "
        "turns concave smoothly. The Ca of the snap-through in `square-pre-inflation`:",
        "",
        *inflation_rows(),
        "",
        "## Transients",
        "",
        "The databases follow a capsule from rest with linearised implicit Euler steps of up to 0.5 l/U, which damp "
        "what would grow and decay again on the way. They give the shape of a capsule whose flow is raised slowly, as "
        "long as the convex shape is stable. The table compares them with the semi-implicit scheme with a tolerance "
        "of 1e-3 l a step, for a sphere in a flow that starts suddenly:",
        "",
        "| refinement | a/l | Ca | L_z/l, at once | L_z/l, long steps | growth rate of either [U/l] | shapes |",
        "|---|---|---|---|---|---|---|",
    ]
    for case in EXACT:
        states = known.get("exact {} {} {}".format(*case), [])
        if len(states) == 2:
            shapes = [_shape(state) for state in states]
            lines.append(
                f"| {' | '.join(map(str, case))} | {states[0]['axial_extent']:.4f} | {states[1]['axial_extent']:.4f} "
                f"| {states[0]['growth']:.2f}, {states[1]['growth']:.2f} "
                f"| {shapes[0] if shapes[0] == shapes[1] else ', '.join(shapes)} |"
            )
    lines += [
        "",
        "Where the two differ both shapes are stable, and which one a capsule takes depends on how it was "
        "started. Those Ca are among the marked ones, and the databases contain the first of the two that a "
        "capsule reaches as the flow is raised.",
    ]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--page"]
    PAGE.write_text(page(compute("--page" in sys.argv, "".join(words))))
