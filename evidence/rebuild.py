"""Recipes of the shipped databases, and ``python -m evidence.rebuild``, which computes one of them again."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial import KDTree
from scipy.stats import qmc

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.output_file import check_replaceable
from capsbayes.membrane_database import FREE_PARAMETERS, THICK, MembraneDatabase, covered, highest_ca, lowest_ca
from capsbayes.physics.build import (
    CAPILLARY_NUMBERS,
    Cases,
    SteadySimulator,
    build_database,
    default_grid,
    grid,
)
from capsbayes.physics.continuation import SLACK_LIMIT
from capsbayes.physics.membrane import GeneralisedHooke, HookeShare, NeoHookean, Skalak, StrainHardening
from capsbayes.physics.scattered import (
    Continuation,
    ScatteredState,
    further_states,
    guess_of,
    membrane_continuation,
    nearest_numbers,
    scattered_dataset,
    scattered_states,
)
from capsbayes.physics.simulator import Simulator, UnsteadySimulator
from capsbayes.run import only_run
from capsbayes.status import Status
from capsbayes.surrogate import MembraneSurrogate
from evidence.command import Arguments, count, path, run

# The cases of databases, beside `default_grid`

_HIGHER = (0.175, 0.2, 0.25, 0.3)  # Ca where laws that stiffen still have steady states
_OF_EFFECTS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.115, 0.13)
_WIDE = grid(CAPILLARY_NUMBERS, 0.7, 0.05, 10)
_STIFFENING = grid(CAPILLARY_NUMBERS + _HIGHER, 0.7, 0.05, 10)
_EFFECT = grid(_OF_EFFECTS, 0.75, 0.05, 7)
_PARACHUTE = [(ca, size) for ca, size in _EFFECT if ca > 0.02]  # the shape reached from rest is not sought in time

# The recipes


@dataclass(frozen=True)
class Recipe:
    """Simulator and cases of a database; for an effect database, also the parameter that varies and its values."""

    simulator: SteadySimulator
    cases: Cases
    effect: str | None = None  # parameter of the simulator or of its law
    values: tuple[float, ...] = ()
    compare: int | None = None  # refinement of the finer mesh for the mesh's error


_FINE = Simulator(refinement=12)
_MEDIUM = Simulator(refinement=10)
_COARSE = Simulator(refinement=8)
_LAWS = {
    "neo-hookean": NeoHookean(),
    "skalak": Skalak(hardening=1.0),
    "hooke": GeneralisedHooke(poisson_ratio=0.5),
    "strain-hardening": StrainHardening(strain_hardening=0.0),
    "hooke-share": HookeShare(hooke_share=0.0),
}
_INFLATIONS = (0.0, 0.01, 0.025, 0.05, 0.1)


def _plain(cross_section: str, law: str, cases: Cases) -> Recipe:
    return Recipe(replace(_FINE, cross_section=cross_section, law=_LAWS[law]), cases, compare=16)


def _effect(
    effect: str, *values: float, cross_section: str = "square", law: str = "neo-hookean", mesh: Simulator = _COARSE
) -> Recipe:
    return Recipe(replace(mesh, cross_section=cross_section, law=_LAWS[law]), _EFFECT, effect, values)


RECIPES: dict[str, Recipe] = {
    "square-neo-hookean": _plain("square", "neo-hookean", default_grid()),
    "circular-neo-hookean": _plain("circular", "neo-hookean", default_grid()),
    **{
        f"{cross_section}-{law}": _plain(cross_section, law, _STIFFENING)
        for cross_section in ("square", "circular")
        for law in ("skalak", "hooke")
    },
    # inflation moves the snap-through and the limit of existence, and with them the coarse mesh's error
    "square-pre-inflation": Recipe(_MEDIUM, _WIDE, "pre_inflation", _INFLATIONS),
    "circular-pre-inflation": Recipe(replace(_COARSE, cross_section="circular"), _WIDE, "pre_inflation", _INFLATIONS),
    "square-hardening": _effect("hardening", 0.1, 0.3, 1.0, 3.0, 10.0, law="skalak"),
    # strain hardening and bending round the sharp rim, and with it the coarse mesh's error is not the same
    "square-strain-hardening": _effect("strain_hardening", 0.0, 0.25, 0.5, 1.0, law="strain-hardening", mesh=_FINE),
    "square-hooke-share": _effect("hooke_share", 0.0, 0.25, 0.5, 1.0, law="hooke-share", mesh=_FINE),
    "square-bending": _effect("bending", 5e-5, 2e-4, 5e-4, 1e-3, 1.7e-3, 3e-3, mesh=_FINE),
    "square-rest-aspect": _effect("rest_aspect", 0.9, 0.95, 1.0, 1.05, 1.1),
    "square-corner-radius": _effect("corner_radius", 0.0, 0.05, 0.1, 0.15, 0.2),
    "square-unsteadiness": Recipe(UnsteadySimulator(_COARSE), _PARACHUTE, "unsteadiness", (0.0, 0.5, 1.0, 1.5, 2.0)),
    "square-section-aspect": replace(
        _effect("section_aspect", 0.9, 0.95, 1.0, 1.05, 1.1, cross_section="rectangular"), cases=_PARACHUTE
    ),
}
"""By name of the database."""


def recipe_named(name: str) -> Recipe:
    """Return the recipe of one database; refuse an unknown name."""
    if name not in RECIPES:
        raise InputError("recipe", "", f"one of {', '.join((*RECIPES, *MEMBRANES))}", repr(name))
    return RECIPES[name]


# States over flow and membrane. The places follow Sobol's sequence, stretched along Ca to where states are sought at
# each size, inflation and hardening. In six dimensions most of a box is near its border, where a polynomial through the
# states of one side is off by far more than inside; and the known laws are on it. So some of the places are moved to
# the border.


class MembraneRecipe(NamedTuple):
    """A cross-section, how many places are sought within a range and on its border, and the meshes."""

    cross_section: str
    thin: tuple[int, int]  # bending stiffness up to `THICK`
    thick: tuple[int, int]  # from there on
    needed: int = 0  # further places, where the model of these states is least sure
    refinement: int = 12
    coarse: int = 8  # refinement of the mesh on which states are sought


MEMBRANES = {
    "membrane-square": MembraneRecipe("square", (2048, 1024), (512, 256), needed=300),
    "membrane-circular": MembraneRecipe("circular", (512, 0), (256, 0)),
}
"""Recipes of the shipped databases over the membrane, by their names."""

_NEAR = 0.2  # share of each range, at either end, from where places are moved to the border


def sobol_places(count: int, dimensions: int) -> Floats:
    """Return the first points of Sobol's sequence that is not scrambled : (count, dimensions) array from 0 to 1."""
    return np.asarray(qmc.Sobol(dimensions, scramble=False).random_base2(int(np.ceil(np.log2(count))))[:count])


def spread_points(states: int, border_states: int) -> Floats:
    """Return points (n, 6) from 0 to 1: first some spread evenly, then some that follow them, moved to the border."""
    # Of the latter, coordinates of the membrane and of the size that are near to an end are moved there: on the average
    # two of a point, so that all faces and many edges and corners have states.
    points = sobol_places(states + border_states, len(FREE_PARAMETERS))
    points[states:, 1:] = _moved_to_the_border(points[states:, 1:])
    return points


def _moved_to_the_border(points: Floats) -> Floats:
    return np.where(points < _NEAR, 0.0, np.where(points > 1.0 - _NEAR, 1.0, points))


def membrane_places(continuation: Continuation, thin: tuple[int, int], thick: tuple[int, int]) -> Floats:
    """Return the places (n, 6) where states of thin and of thick membranes are sought; see `spread_points`."""
    places, further = spread_points(*thin), spread_points(*thick)
    middle = continuation.axes[-1].unit(THICK)
    places[:, -1] *= middle
    further[:, -1] = middle + (1.0 - middle) * further[:, -1]
    places = np.concatenate([places, further])
    cross_section = str(continuation.settings["cross_section"])
    along = continuation.axes[0]
    spread = _spread_along(places[:, 0], continuation.values(places), cross_section)
    places[:, 0] = [along.unit(float(ca)) for ca in spread]
    return places


def _spread_along(units: Floats, values: Floats, cross_section: str) -> Floats:
    """Return Ca (n,) from the lowest to the highest at the other parameters, values (n, 6)."""
    _, size, inflation, _, hardening, _ = values.T
    low, high = lowest_ca(inflation), highest_ca(size, hardening, cross_section)
    return np.asarray(low * (high / low) ** units)


def build_membranes(
    recipe: MembraneRecipe, *, out: Path, scheduler: str | None = None, workers: int | None = None
) -> MembraneDatabase:
    """Simulate a database over flow and membrane; finished states are kept in ``OUT.*parts``."""
    # They are sought on the coarse mesh, where those that it does not resolve count as lost, then on the fine one.
    check_replaceable(out)
    continuation = membrane_continuation(recipe.cross_section, recipe.coarse)
    places = membrane_places(continuation, recipe.thin, recipe.thick)
    start = continuation.taken(continuation.simulator.run(capillary_number=0.06, size_ratio=0.9))  # a parachute
    on: dict[str, Any] = {"scheduler": scheduler, "workers": workers}
    sought = resolved(scattered_states(continuation, start, places, folder=f"{out}.coarse.parts", **on))
    coarse = MembraneDatabase.of(scattered_dataset(continuation, places, sought))
    fine = membrane_continuation(recipe.cross_section, recipe.refinement)
    refined = resolved(refined_states(coarse, fine, folder=f"{out}.parts", again=True, **on))
    database = _with_mesh_errors(coarse, fine, refined)
    if recipe.needed:
        further = needed_places(database, continuation, recipe.needed)
        more = resolved(further_states(coarse, continuation, further, folder=f"{out}.needed.coarse.parts", **on))
        reached = [number for number, state in enumerate(more) if state is not None]
        coarse = MembraneDatabase.of(
            scattered_dataset(continuation, further[reached], [more[number] for number in reached])
        )
        refined = resolved(refined_states(coarse, fine, folder=f"{out}.needed.parts", again=False, **on))
        # What either mesh lacks is left out, not lost: it lies next to the end of the branch, and some of it exists.
        found = [number for number, state in enumerate(refined) if state is not None]
        database = database.joined(
            _with_mesh_errors(coarse.taken(found), fine, [refined[number] for number in found]).dataset
        )
    database.write(out)
    return database


def _with_mesh_errors(
    coarse: MembraneDatabase, continuation: Continuation, states: Sequence[ScatteredState | None]
) -> MembraneDatabase:
    dataset = scattered_dataset(continuation, continuation.places(coarse["values"]), states)
    return MembraneDatabase.of(with_mesh_errors(dataset, coarse))


_SEEN = np.array([0.014, 0.014, 0.01])  # errors of L_z [l], L_a [l] and v_o/U that a picture leaves
_APART = 0.3  # least distance of needed places, over the ranges


def needed_places(database: MembraneDatabase, continuation: Continuation, count: int) -> Floats:
    """Return the places (count, 6) where a model says the largest errors, apart from each other."""
    # Of 32,768 of Sobol's, every other moved to the border where it is near it.
    points = np.asarray(qmc.Sobol(len(FREE_PARAMETERS), scramble=True, rng=11).random_base2(15))
    points[1::2, 1:] = _moved_to_the_border(points[1::2, 1:])
    values = continuation.values(points)
    values[:, 0] = _spread_along(points[:, 0], values, database.cross_section)
    values = values[covered(values, database.cross_section)]
    said = MembraneSurrogate(database)(dict(zip(FREE_PARAMETERS, values.T, strict=True)))
    error = np.max(np.sqrt(np.diagonal(said.covariance, axis1=1, axis2=2)) / _SEEN, axis=1)
    error[~said.inside | np.isnan(error)] = 0.0
    places = continuation.places(values)
    chosen: list[int] = []
    for number in np.argsort(-error):
        if len(chosen) == count:
            break
        if not chosen or np.min(np.linalg.norm(places[chosen] - places[number], axis=1)) > _APART:
            chosen.append(number)
    return places[chosen]


def refined_states(
    database: MembraneDatabase, continuation: Continuation, *, folder: str, **how: Any
) -> list[ScatteredState | None]:
    """Compute the states of a database on the finer mesh of a continuation, None where one is lost; keep them."""
    places = continuation.places(database["values"])
    with only_run(Path(folder)):
        return further_states(database, continuation, places, folder=folder, way=_refined, **how)


def _refined(database: MembraneDatabase, continuation: Continuation, place: Floats) -> ScatteredState | None:
    number = nearest_numbers(database, continuation, place)[0]
    return continuation.corrected(guess_of(database, continuation, number))


# Error of a mesh of refinement 12 over the change to it from one of 8. The change from 12 to 16 is 0.29 of that from 8
# to 12 (median of 39 states, quartiles 0.25 and 0.38), mostly in the same direction: between this and 0.57, by the
# order of convergence that it shows, is left
_OF_REFINING = 0.4
_SAME = 1e-9  # distance of parameters over their ranges, within which states are the same
_LIKE = 12  # fine states next to one that is lost on the fine mesh, of which the mean change is taken


def with_mesh_errors(dataset: xr.Dataset, coarse: MembraneDatabase) -> xr.Dataset:
    """Return a dataset of states with the errors of their mesh, from the same states on a coarser one.

    A state that the fine mesh lacks is the coarse one with the mean change of its neighbours, and that is its error.
    """
    # ``numbers_mesh_error`` (n, 4), and for either view ``profile_mesh_error`` (n, m) of the modes
    fine = membrane_continuation(coarse.cross_section, json.loads(dataset.attrs["settings"])["refinement"])
    places, here = fine.places(coarse["values"]), fine.places(dataset["values"].values)
    distance, same = KDTree(places).query(here)
    if np.max(distance) > _SAME:
        missing = int(np.count_nonzero(distance > _SAME))
        raise InputError("coarse", "states", "one with the parameters of each fine state", f"none for {missing}")
    lacking = np.setdiff1d(np.arange(len(coarse)), same)
    away, near = map(np.asarray, KDTree(here).query(places[lacking], np.arange(1, min(_LIKE, len(here)) + 1)))
    weights = np.exp(-((2.0 * away / away[:, -1:]) ** 2))
    weights /= weights.sum(axis=1, keepdims=True)

    kept = ("values", "slack", "numbers", "numbers_along", "tension", "tension_along", "tension_place")
    there = {name: coarse[name].copy() for name in kept}
    for view in ("profile", "silhouette"):
        modes = dataset[f"{view}_modes"].values
        inverse = np.linalg.pinv(modes.reshape(len(modes), -1)).reshape(*modes.shape[1:], -1)
        turned = np.tensordot(coarse[f"{view}_modes"], inverse, 2)
        offset = np.tensordot(coarse[f"{view}_mean"] - dataset[f"{view}_mean"].values, inverse, 2)
        there[view] = offset + coarse[view] @ turned
        there[f"{view}_along"] = np.einsum("nkp,km->nmp", coarse[f"{view}_along"], turned)
    errors = {}
    for name in ("numbers", "profile", "silhouette"):
        change = dataset[name].values - there[name][same]
        mean = np.einsum("nk,nkm->nm", weights, change[near])
        there[name][lacking] += mean
        errors[f"{name}_mesh_error"] = dataset[name].dims, np.concatenate([_OF_REFINING * change, mean])
    starts = [guess_of(coarse, fine, number).unknowns[:-2] for number in lacking]
    further = {name: values[lacking] for name, values in there.items()}
    mean, modes = dataset["mesh_mean"].values, dataset["mesh_modes"].values
    further["mesh"] = (np.reshape(starts, (-1, len(mean))) - mean) @ modes.T
    both = {name: (dataset[name].dims, np.concatenate([dataset[name], more])) for name, more in further.items()}
    both["lost"] = dataset["lost"].dims, coarse["lost"]
    return dataset.drop_vars([*both, *errors], errors="ignore").assign({**both, **errors})


def resolved(states: Sequence[ScatteredState | None]) -> list[ScatteredState | None]:
    """Return the states, None for those that the mesh does not resolve."""
    return [None if state is None or abs(state.slack) > SLACK_LIMIT else state for state in states]


def rebuild(given: argparse.Namespace) -> int:
    """Simulate every case of a shipped database, print their statuses, and return 1 if not one case converged."""
    out: Path = given.out
    if out.suffix != ".nc":
        raise InputError("rebuild", "--out", "a file name that ends in .nc", repr(str(out)))
    if not out.parent.is_dir():
        raise InputError("rebuild", "--out", "a folder that exists", repr(str(out.parent)))
    on = {"scheduler": given.scheduler, "workers": given.workers}
    if given.name in MEMBRANES:
        states = build_membranes(MEMBRANES[given.name], out=out, **on).as_dict()
        print(f"{out}: {states['states']} states, {states['lost']} lost\nsha256  {states['sha256']}")
        return 0
    begin, recipe = time.perf_counter(), recipe_named(given.name)
    database = build_database(
        recipe.simulator,
        recipe.cases,
        out=out,
        effect=recipe.effect,
        values=recipe.values,
        compare=recipe.compare,
        compact=not given.full,
        **on,
    )
    print(f"{out}: {len(database)} cases in {time.perf_counter() - begin:.1f} s")
    for name, number in database.as_dict()["statuses"].items():
        print(f"{number:6d}  {Status[name]}")
    print(f"sha256  {database.sha256}")
    return int(not len(database.converged))


def main() -> None:
    """Read the arguments and run."""
    arguments = Arguments(
        "rebuild",
        "Simulate every case of a shipped database; a second run continues where the first stopped. Exit status: 0 "
        "done, 1 not one case converged, 2 bad input.",
    )
    add = arguments.add_argument
    add("name", help="name of the database, as square-neo-hookean, or membrane-square")
    add("--out", type=path, required=True, help="NetCDF file to write; finished cases are kept in OUT.parts")
    add("--full", action="store_true", help="keep the nodes of the membrane and outlines in double precision")
    add("--scheduler", help="address of a dask cluster that sees the same files (default: this machine)")
    add("--workers", type=count, help="worker processes on this machine (default: one per core)")
    run(arguments, rebuild)


if __name__ == "__main__":
    main()
