"""Simulate shapes between the nodes of shipped databases, and store them in ``data/fresh.npz``.

Run ``python -m evidence.benchmarks.fresh FOLDER [NAME ...]``. The shapes are built as databases are, one file in FOLDER
for each size of an effect, so that an interrupted run resumes; what has converged is then stored. The simulations are
at refinement 12, the mesh of the plain databases.

The cases of a database lie at forty points: a few pairs of a/l and of its effect, spread evenly, and Ca from the lower
to the upper border of its surrogate there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from capsbayes.database import Database
from capsbayes.physics.build import build_database
from capsbayes.surrogate import EffectSurrogate, Surrogate
from evidence.benchmarks.stored import ROOT, arguments
from evidence.rebuild import Recipe, recipe_named

FRESH = ROOT / "data" / "fresh.npz"
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
QUANTITIES = (
    "size_ratio",
    "capillary_number",
    "axial_extent",
    "axial_length",
    "velocity_ratio",
    "stretch_ratio",
    "parachute_depth",
)


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
        for coordinate, (low, high, *_) in model.coordinates.items():
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
    """Build what the folder lacks of the cases of one database, a file for each size of its effect."""
    chosen = cases(name, folder)
    for effect in dict.fromkeys(case[0] for case in chosen):
        simulator, of_effect = simulator_at(recipe_named(name), effect), [case for case in chosen if case[0] == effect]
        out = folder / name / f"{effect!r}.nc"
        if not out.exists():
            build_database(simulator, [(ca, size) for _, size, ca in of_effect], out=out, compact=True)


def simulator_at(recipe: Recipe, value: float) -> Any:
    """Return the simulator of a recipe on the fine mesh at one value of its effect, a parameter of it or of its law."""
    simulator: Any = recipe.simulator.refined(REFINEMENT)
    if recipe.effect is None:
        return simulator
    if hasattr(simulator, recipe.effect):
        return replace(simulator, **{recipe.effect: value})
    return replace(simulator, law=replace(simulator.law, **{recipe.effect: value}))


def converged(name: str, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the converged cases of a database that the folder holds, without those that building adds at borders."""
    files = sorted((folder / name).glob("*.nc"))
    chosen = {(size, ca) for _, size, ca in (cases(name, folder) if files else ())}
    for path in files:
        built = Database.read(path).converged
        places = zip(built["size_ratio"].tolist(), built["capillary_number"].tolist(), strict=True)
        for row in [row for row, place in enumerate(places) if place in chosen]:
            profile = built["profile"][row]
            case = {"database": name, "effect_value": float(path.stem)} | {key: built[key][row] for key in QUANTITIES}
            yield case | {"half_profile": profile[: len(profile) // 2 + 1].astype(np.float32)}


def collect(folder: Path) -> None:
    """Store the converged cases that the folder holds; those of other databases stay as they are stored."""
    rows = [row for name in NAMES for row in converged(name, folder)]
    with np.load(FRESH, allow_pickle=False) as stored:
        columns = dict(stored)
    others = ~np.isin(columns["database"], [row["database"] for row in rows])
    whole = {key: np.array([*(row[key] for row in rows), *values[others]]) for key, values in columns.items()}
    np.savez_compressed(FRESH, **whole)
    print(f"{len(whole['database'])} cases in {FRESH}, {FRESH.stat().st_size} bytes")


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path, help="where finished cases are kept")
    parser.add_argument("names", nargs="*", metavar="NAME", help="databases; by default all, see NAMES")
    parser.add_argument("--collect-only", action="store_true", help="store what has ended")
    given = parser.parse_args()
    if not given.collect_only:
        for name in given.names or NAMES:
            simulate(name, given.folder)
    collect(given.folder)


if __name__ == "__main__":
    main()
