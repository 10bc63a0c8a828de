"""Pools of simulated shapes from which blind sessions are drawn: one database for each effect and size."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import xarray as xr

from capsbayes.database import Database, content_hash
from capsbayes.errors import InputError
from capsbayes.evidence.blind.effects import TRUE_EFFECTS, TrueEffect
from capsbayes.physics.build import Cases, SteadySimulator, build_database
from capsbayes.physics.simulator import Simulator, UnsteadySimulator

_CAPILLARY_NUMBERS = (0.0315, 0.0365, 0.042, 0.0475, 0.0545, 0.0625, 0.0725, 0.0845, 0.0965, 0.107)
_SIZE_RATIOS = (0.79, 0.818, 0.862, 0.89, 0.933, 0.963)
_DIGITS = 4
_REFINEMENT = 12  # on a coarser mesh the truth itself is wrong: at 10, L_z by 0.006 l at Ca 0.107

_SIZES: dict[str, tuple[float, ...]] = {
    "none": (0.0,),
    "pre_inflation": (0.008, 0.015, 0.035),
    "bending": (6e-4, 2e-3),
    "rest_aspect": (0.925, 1.03, 1.075),
    "corner_radius": (0.07, 0.16),
    "section_aspect": (0.925, 1.03, 1.075),
    "strain_hardening": (0.3, 0.8),
    "unsteadiness": (0.7, 1.5),
    "hooke_share": (1.0,),
}

BLOCKS = MappingProxyType({("none", 0.0): 10})
"""Number of files of a pool, if more than one: the first is a lattice, the further ones are at random places."""

POOLS = MappingProxyType({(effect, size): TRUE_EFFECTS[effect] for effect, sizes in _SIZES.items() for size in sizes})
"""True effect of each pool, by its name and size."""


def pool_name(effect: str, size: float, block: int = 0) -> str:
    """Return the name of a pool's file, or of one of its further files, without its ending."""
    return f"{effect.replace('_', '-')}-{size:g}" + (f"-block-{block}" if block else "")


def pool_cases(block: int = 0) -> Cases:
    """Return Ca and a/l of the shapes of each file of a pool."""
    # Those of the first are all between the nodes of the shipped databases. Those of a further one are drawn at random,
    # one in each cell of the lattice of the first.
    if block == 0:
        return [(ca, size) for size in _SIZE_RATIOS for ca in _CAPILLARY_NUMBERS]
    rng = np.random.default_rng([block, len(_SIZE_RATIOS)])
    sizes = _between(_SIZE_RATIOS, rng, _DIGITS)
    return [(ca, size) for size in sizes for ca in _between(_CAPILLARY_NUMBERS, rng, _DIGITS + 2)]


def _between(places: tuple[float, ...], rng: np.random.Generator, digits: int) -> list[float]:
    """Draw as many places, in equal parts of the range of some."""
    parts = np.arange(len(places)) + rng.random(len(places))
    low, high = places[0], places[-1]
    return [round(float(low * (high / low) ** (part / len(places))), digits) for part in parts]


def read_pool(folder: str | os.PathLike[str], effect: str, size: float) -> Database:
    """Return all shapes of a pool in a folder, as far as its files are there."""
    names = [pool_name(effect, size, block) for block in range(BLOCKS.get((effect, size), 1))]
    first, *further = [Path(folder) / f"{name}.nc" for name in names]
    pool = Database.read(first)
    more = [Database.read(path).dataset.isel(border=slice(0)) for path in further if path.exists()]
    if not more:
        return pool
    whole = xr.concat(
        [pool.dataset.isel(border=slice(0)), *more],
        "case",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        combine_attrs="override",
    )
    return Database(whole.assign_attrs(sha256=content_hash(whole)))


def simulator_with(effect: TrueEffect, size: float, refinement: int = _REFINEMENT) -> SteadySimulator:
    """Return the simulator of a neo-Hookean capsule in a square channel with a true effect."""
    changed = dict(effect.simulated(size))
    unsteadiness = changed.pop("unsteadiness", 0.0)
    simulator = replace(Simulator(refinement=refinement), **changed)
    return UnsteadySimulator(simulator, unsteadiness) if unsteadiness else simulator


def build_pools(
    names: Iterable[tuple[str, float]],
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    further: bool = False,
) -> dict[tuple[str, float], Database]:
    """Build those of some pools, named by keys of `POOLS`, that a folder lacks, and return all pools."""
    # The further files of a pool are built only if they are asked for; pools of other settings or cases are refused.
    pools = {}
    for effect, size in names:
        simulator = simulator_with(POOLS[effect, size], size)
        for block in range(BLOCKS.get((effect, size), 1) if further else 1):
            path, cases = Path(folder) / f"{pool_name(effect, size, block)}.nc", pool_cases(block)
            if not path.exists():
                build_database(simulator, cases, out=path, workers=workers, compact=True)
            part = Database.read(path)
            missing = {*cases} - {*zip(part["capillary_number"].tolist(), part["size_ratio"].tolist(), strict=True)}
            _check_pool(path, _different(part, simulator) + ["cases"] * bool(missing))
        pools[effect, size] = read_pool(folder, effect, size)
    return pools


def read_shapes(path: str | os.PathLike[str], effect: TrueEffect, size: float) -> Database:
    """Return the database of a file, on whatever mesh, as the shapes of capsules with a true effect."""
    shapes = Database.read(path)
    different = set(_different(shapes, simulator_with(effect, size))) - {"refinement"}
    if different:
        expected, advice = "shapes that were simulated with the effect", "omit --shapes"
        raise InputError(str(path), "", expected, f"ones with other {', '.join(sorted(different))}", advice)
    return shapes


def _different(pool: Database, simulator: SteadySimulator) -> list[str]:
    """Return the names of the settings that a database does not share with a simulator."""
    asked, there = json.loads(json.dumps(dict(simulator.settings))), pool.settings
    return sorted(key for key in {*asked, *there} if asked.get(key) != there.get(key))


def _check_pool(path: Path, different: list[str]) -> None:
    if different:
        got = f"one made with other {', '.join(different)}"
        raise InputError(str(path), "", "the pool of shapes of this name", got, "remove it to build it anew")
