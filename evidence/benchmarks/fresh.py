"""Simulate shapes between the nodes of shipped databases, and store them in ``data/fresh.npz``.

Run ``python -m evidence.benchmarks.fresh FOLDER [NAME ...]``. Each finished case is kept in FOLDER, so that an
interrupted run resumes; what has ended is then stored. The simulations are at refinement 12, the mesh of the plain
databases.

The cases of a database lie at forty points: a few pairs of a/l and of its effect, spread evenly, and Ca from the lower
to the upper border of its surrogate there. Up to Ca 0.03 the shape is that which a capsule reaches from rest; above,
parachutes are followed from the first that is found.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from capsbayes.physics.build import CaseRunner, Outcome
from capsbayes.run import Store
from capsbayes.surrogate import EffectSurrogate, Surrogate
from evidence.rebuild import Recipe, recipe_named

STORED = Path(__file__).parents[2] / "data" / "fresh.npz"
REFINEMENT = 12
NAMES = (
    "circular-hooke",
    "circular-pre-inflation",
    "square-pre-inflation",
    "square-hooke",
    "circular-neo-hookean",
    "square-neo-hookean",
    "square-hardening",
    "square-skalak",
    "circular-skalak",
)
COUNT, PAIRS = 40, 8
FROM_REST, PARACHUTE = 0.03, 0.05
STEP = 0.5  # largest change of log Ca that one step follows
QUANTITIES = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio", "parachute_depth")


def cases(name: str, folder: Path) -> list[tuple[float, float, float]]:
    """Return (effect value, a/l, Ca) of the cases of a database, by pairs of the first two; they are chosen once."""
    kept = folder / name / "cases.json"
    if not kept.exists():
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(chosen_cases(Surrogate.open(name))))
    return [tuple(case) for case in json.loads(kept.read_text())]


def chosen_cases(model: Surrogate | EffectSurrogate) -> list[tuple[float, float, float]]:
    """Return cases between the borders of a surrogate."""
    first, last = model.domain.bounds[1]
    ladder, chosen = np.geomspace(0.002, 0.35, 2000), []
    for share, along in qmc.Halton(2, scramble=True, rng=7).random(4 * PAIRS):
        size, effect, at = round(first + 0.01 + share * (last - first - 0.02), 4), 0.0, {}
        for coordinate, (low, high, _) in model.coordinates.items():
            effect = low * (high / low) ** along if coordinate == "hardening" else low + along * (high - low)
            effect = round(effect, 5)
            at[coordinate] = np.full_like(ladder, effect)
        known = ladder[model.domain.contains(ladder, np.full_like(ladder, size), *at.values())]
        if len(known) and len(chosen) < COUNT:
            count = COUNT // PAIRS
            places = (np.arange(count) + 0.2 + 0.6 * ((len(chosen) // count * 0.618) % 1.0)) / count
            roots = np.sqrt(known[0]) + places * (np.sqrt(known[-1]) - np.sqrt(known[0]))
            chosen += [(effect, size, float(f"{ca:.4g}")) for ca in roots**2]
    return chosen


def simulate(name: str, folder: Path) -> None:
    """Simulate the cases of one database that the folder lacks."""
    chosen = cases(name, folder)
    for pair in dict.fromkeys(case[:2] for case in chosen):
        effect, size = pair
        simulator = simulator_at(recipe_named(name), effect)
        store = Store.open(folder / name / f"{effect!r}", simulator.settings)
        runner = CaseRunner(simulator, store, size)
        run_pair(runner, sorted(ca for *other, ca in chosen if tuple(other) == pair), name)


def simulator_at(recipe: Recipe, value: float) -> Any:
    """Return the simulator of a recipe on the fine mesh at one value of its effect, a parameter of it or of its law."""
    simulator: Any = recipe.simulator.refined(REFINEMENT)
    if recipe.effect is None:
        return simulator
    if hasattr(simulator, recipe.effect):
        return replace(simulator, **{recipe.effect: value})
    return replace(simulator, law=replace(simulator.law, **{recipe.effect: value}))


def run_pair(runner: CaseRunner, capillary_numbers: list[float], name: str) -> None:
    """Run the cases of one a/l: low ones from rest, the others along the parachutes in both directions."""
    high = [ca for ca in capillary_numbers if ca > FROM_REST]
    wanted = [(ca, "rest") for ca in capillary_numbers if ca <= FROM_REST]
    middle = min(range(len(high)), key=lambda i: abs(np.log(high[i] / PARACHUTE)), default=0)
    first = reported(runner, high[middle], "rest", name) if high else None
    for way in (high[middle + 1 :], high[:middle][::-1]):
        last = first
        for ca in way:
            while last is not None and last.done and abs(np.log(ca / last.capillary_number)) > STEP:
                between = last.capillary_number * np.exp(STEP * np.sign(ca - last.capillary_number))
                last = reported(runner, float(f"{between:.4g}"), last, name)
            if last is None or not last.done:
                break
            last = reported(runner, ca, last, name)
    for ca, start in wanted:
        reported(runner, ca, start, name)


def reported(runner: CaseRunner, ca: float, start: Any, name: str) -> Outcome:
    begun = time.process_time()
    outcome = runner.run(ca, start)
    seconds = time.process_time() - begun
    if seconds > 0.5:
        print(f"{name} a/l {runner.size_ratio:g} Ca {ca:g}: {outcome.status.name}, {seconds:.0f} s", flush=True)
    return outcome


def collect(folder: Path) -> None:
    """Store the converged cases that the folder holds; those of other databases stay as they are stored."""
    rows: dict[str, list[Any]] = {key: [] for key in ("database", "effect_value", "size_ratio", "capillary_number")}
    rows |= {key: [] for key in (*QUANTITIES, "half_profile")}
    for name in NAMES:
        recipe, chosen = recipe_named(name), cases(name, folder) if (folder / name).is_dir() else []
        for effect, size, ca in sorted(chosen):
            store_folder = folder / name / f"{effect!r}"
            if not store_folder.is_dir():
                continue
            finer = simulator_at(recipe, effect)
            store = Store.open(store_folder, finer.settings)
            starts = {
                part.partition("_from-")[2].rpartition(".")[0] for part in store.names(f"size-{size!r}_ca-{ca!r}_*")
            }
            for start in sorted(starts):
                outcome = Outcome.find(store, ca, size, start if start == "rest" else float(start), finer.restored)
                if outcome is None or not outcome.done:
                    continue
                values = (name, effect, size, ca, *(outcome.variables[key] for key in QUANTITIES))
                profile = outcome.variables["profile"]
                for key, value in zip(
                    rows, (*values, profile[: len(profile) // 2 + 1].astype(np.float32)), strict=True
                ):
                    rows[key].append(value)
    if STORED.exists():
        with np.load(STORED, allow_pickle=False) as stored:
            for k in np.flatnonzero(~np.isin(stored["database"], rows["database"])):
                for key, values in rows.items():
                    values.append(stored[key][k])
    np.savez_compressed(STORED, **{key: np.array(value) for key, value in rows.items()})
    print(f"{len(rows['database'])} cases in {STORED}, {STORED.stat().st_size} bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where finished cases are kept")
    parser.add_argument("names", nargs="*", metavar="NAME", help="databases; by default all, see NAMES")
    parser.add_argument("--collect-only", action="store_true", help="store what has ended")
    options = parser.parse_args()
    if not options.collect_only:
        for name in options.names or NAMES:
            simulate(name, options.folder)
    collect(options.folder)


if __name__ == "__main__":
    main()
