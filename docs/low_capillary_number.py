"""Which shapes there are at low Ca, which are stable, and which one a capsule started from rest reaches.

``python docs/low_capillary_number.py`` traces the branches, follows transients, and writes the page
``docs/low-capillary-number.md`` with its pictures. What is computed is kept in ``docs/data/low-capillary-number.json``;
run again, the script computes only what is missing (``--page``: nothing, it writes the page of what is there).
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import Simulator
from capsbayes.simulation.arclength import fold, traced
from capsbayes.simulation.continuation import near_rest, parachute
from capsbayes.simulation.outlines import profile
from capsbayes.simulation.problem import Iterate, Problem
from capsbayes.simulation.steady_state import steady_state
from capsbayes.simulation.transient import growth_rates, transient

matplotlib.use("agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
STORE = HERE / "data" / "low-capillary-number.json"
PAGE = HERE / "low-capillary-number.md"
REFINEMENT = 8
Results = dict[str, list[dict[str, float]]]
SETTINGS = (
    {"bending": 2e-4, "pre_inflation": 0.0},
    {"bending": 1e-3, "pre_inflation": 0.0},
    {"bending": 5e-5, "pre_inflation": 0.0},
    {"bending": 2e-4, "pre_inflation": 0.01},
    {"bending": 2e-4, "pre_inflation": 0.025},
)
SIZES = (0.75, 0.9, 1.0, 1.1)
HIGHEST, LOWEST = 0.05, 0.002
TIMES = (12.0,)  # U t / l at which a transient ends, if it is not steady before
TRANSIENTS = {0.75: (0.01, 0.012, 0.014, 0.016, 0.02), 0.9: (0.01, 0.0135, 0.0155, 0.02), 0.95: (0.01, 0.02)}


def measured(problem: Problem, iterate: Iterate) -> dict[str, float]:
    """Lengths over l, velocity over U, and whether small symmetric disturbances decay."""
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


def branch(problem: Problem, start, *, rising: bool) -> Iterator[dict[str, float]]:
    """States of a branch between the lowest and the highest Ca, through its folds."""
    before, turns = None, 0
    for point in traced(problem, start, rising=rising):
        if before is not None and before.rising != point.rising:
            turns += 1
            yield measured(problem, fold(problem, before, point).result.iterate) | {"fold": 1.0}
        yield measured(problem, point.result.iterate)
        if not LOWEST < point.result.iterate.capillary_number < HIGHEST * 1.01 or turns == 3:
            return
        before = point


def from_rest(problem: Problem, ca: float, size: float) -> dict[str, float]:
    """End of a transient from rest, and the steady state next to it."""
    *_, end = transient(problem, problem.at_rest(ca, size), TIMES, steady=1e-3)
    found = steady_state(problem, end.iterate)
    state = measured(problem, found.iterate)
    return state | {"time": end.time, "speed": end.speed, "converged": float(found.converged)}


def tasks() -> Iterator[tuple[str, Problem, float, float | None]]:
    """Everything to compute, what matters most first."""
    base = Simulator(refinement=REFINEMENT)
    for size, values in TRANSIENTS.items():
        for ca in values:
            yield f"transient {size} {ca}", base.problem, size, ca
    for settings in SETTINGS:
        problem = replace(base, **settings).problem
        name = " ".join(f"{key}={value}" for key, value in settings.items())
        for size in SIZES:
            yield f"rest {name} {size}", problem, size, None
            yield f"parachute {name} {size}", problem, size, None


def compute(only_page: bool) -> Results:
    """Everything, from the store where it is there; with `only_page`, nothing that is not."""
    known = json.loads(STORE.read_text()) if STORE.exists() else {}
    for name, problem, size, ca in tasks():
        if name in known or only_page:
            continue
        kind = name.split()[0]
        if kind == "transient":
            states = [from_rest(problem, ca, size)]
        else:
            end = near_rest(problem, size) if kind == "rest" else parachute(problem, HIGHEST, size)
            states = list(branch(problem, end.result, rising=kind == "rest")) if end.result.converged else []
        known[name] = [{key: float(f"{value:.6g}") for key, value in state.items()} for state in states]
        partial = STORE.with_suffix(".tmp")
        partial.write_text(json.dumps(known, indent=1) + "\n")
        os.replace(partial, STORE)
        print(name, len(states), file=sys.stderr, flush=True)
    return known


def label(settings: dict[str, float]) -> str:
    """Name of a setting as people read it."""
    return f"B = {settings['bending']:g}, alpha = {settings['pre_inflation']:g}"


def stored(known: Results, kind: str, settings: dict[str, float], size: float) -> list[dict[str, float]] | None:
    """States of one branch, or None if it has not been computed."""
    name = " ".join(f"{key}={value}" for key, value in settings.items())
    return known.get(f"{kind} {name} {size}")


def fold_of(states: list[dict[str, float]] | None) -> str:
    """Ca at the first fold of a branch, as text."""
    if states is None:
        return "not computed"
    return next((f"{state['ca']:.4f}" for state in states if "fold" in state), "none")


def draw(known: Results, settings: dict[str, float]) -> Path:
    """Lengths over the rest diameter along the branches, one panel for each size."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 7), sharex=True, constrained_layout=True)
    for axis, size in zip(axes.flat, SIZES, strict=True):
        for kind, colour in (("rest", "#0072b2"), ("parachute", "#d55e00")):
            states = stored(known, kind, settings, size) or []
            ca = np.array([state["ca"] for state in states])
            stable = np.array([state["growth"] < 0 for state in states])
            for quantity, marker in (("axial_extent", "o"), ("axial_length", "v")):
                length = np.array([state[quantity] for state in states]) / (2 * size)
                axis.plot(ca, length, "-", color=colour, linewidth=0.8)
                for chosen, fill in ((stable, colour), (~stable, "white")):
                    axis.plot(ca[chosen], length[chosen], marker, color=colour, markerfacecolor=fill, markersize=4)
        if settings == SETTINGS[0]:
            for ca_from_rest in TRANSIENTS.get(size, ()):
                for state in known.get(f"transient {size} {ca_from_rest}", []):
                    lengths = np.array([state["axial_extent"], state["axial_length"]])
                    axis.plot([state["ca"]] * 2, lengths / (2 * size), "k+", markersize=10)
        axis.set(title=f"a/l = {size}", xscale="log", xlim=(LOWEST, HIGHEST))
        axis.xaxis.set_major_formatter("{x:g}")
    for axis in axes[1]:
        axis.set_xlabel("Ca")
    for axis in axes[:, 0]:
        axis.set_ylabel("L_z / 2a (circles), L_a / 2a (triangles)")
    figure.suptitle(f"{label(settings)}: from rest (blue), parachutes (red); open: unstable; +: transients from rest")
    path = HERE / "pictures" / f"low-{settings['bending']:g}-{settings['pre_inflation']:g}.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path


def page(known: Results) -> str:
    """The page, with every number from the store."""
    lines = [
        "# Shapes at low capillary number",
        "",
        f"Made by `python docs/low_capillary_number.py` (square channel, neo-Hookean, refinement {REFINEMENT}).",
        "",
        "A capsule at rest that is set in motion at a low Ca keeps a convex rear. As Ca grows, that branch of steady",
        "states ends in a fold: the capsule **snaps through** to a parachute. Followed down in Ca, the parachute keeps",
        "its dimple until its own fold, where it **snaps back**. Between the two Ca both shapes are steady, and stable",
        "to disturbances of the channel's symmetry. Which one is seen depends on the history: the databases hold the",
        "one that a capsule started from rest reaches, and mark Ca below the snap-through.",
        "",
        "## Where both shapes exist",
        "",
        "| bending, pre-inflation | a/l | snap-through (from rest, rising Ca) | snap-back (parachute, falling Ca) |",
        "|---|---|---|---|",
    ]
    for settings in SETTINGS:
        for size in SIZES:
            ends = [fold_of(stored(known, kind, settings, size)) for kind in ("rest", "parachute")]
            lines.append(f"| {label(settings)} | {size} | {ends[0]} | {ends[1]} |")
    lines += [
        "",
        '"none": the branch has no fold between Ca = '
        f"{LOWEST:g} and {HIGHEST:g}; the rear turns smoothly from convex to concave.",
        "",
        "## What a capsule started from rest does",
        "",
        "| a/l | Ca | L_z/l | L_a/l | v_o/U | largest growth rate [U/l] | shape |",
        "|---|---|---|---|---|---|---|",
    ]
    for size, values in TRANSIENTS.items():
        for ca in values:
            for state in known.get(f"transient {size} {ca}", []):
                shape = "parachute" if state["axial_extent"] - state["axial_length"] > 1e-4 else "convex"
                lines.append(
                    f"| {size} | {ca} | {state['axial_extent']:.4f} | {state['axial_length']:.4f} "
                    f"| {state['velocity_ratio']:.4f} | {state['growth']:.2f} | {shape} |"
                )
    lines += ["", "## The branches", ""]
    for settings in SETTINGS:
        if any(stored(known, kind, settings, size) for kind in ("rest", "parachute") for size in SIZES):
            lines += [f"![{label(settings)}](pictures/{draw(known, settings).name})", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        PAGE.write_text(page(compute("--page" in sys.argv)))
