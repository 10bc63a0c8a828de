"""Recipe of the states over flow and membrane that come with the library.

The places follow Sobol's sequence, stretched along Ca to where states are sought at each size, inflation and hardening.
In six dimensions most of a box is near its border, where a polynomial through the states of one side is off by far more
than inside; and the known laws are on it. So some of the places are moved to the border.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.output_file import check_replaceable, guarded
from capsbayes.membrane_database import FREE_PARAMETERS, RANGES, MembraneDatabase, highest_ca, lowest_ca
from capsbayes.physics.continuation.branches import SLACK_LIMIT
from capsbayes.physics.databases.scattered import (
    Axis,
    Continuation,
    ScatteredState,
    scattered_dataset,
    scattered_states,
    sobol_places,
)
from capsbayes.physics.membrane.general import GeneralLaw
from capsbayes.physics.simulation.simulator import Simulator
from capsbayes.physics.surface.octasphere import prolonged


class Recipe(NamedTuple):
    """A cross-section, and how many places are sought within the range and on its border."""

    cross_section: str
    states: int
    border_states: int


MEMBRANES = {
    "membrane-square": Recipe("square", 2048, 1024),
    "membrane-circular": Recipe("circular", 1024, 512),
}
"""Recipes of the shipped databases over the membrane, by their names."""

_OFFSETS = (0.0, None, 0.01, 0.0, None, 0.0)  # of the logarithms along which places are spread; None: evenly
_NEAR = 0.2  # share of each range, at either end, from where places are moved to the border
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


def membrane_start(continuation: Continuation) -> ScatteredState:
    """Return the state from which the others are reached: a parachute, sought from rest."""
    return continuation.taken(continuation.simulator.run(capillary_number=0.06, size_ratio=0.9))


def spread_points(states: int, border_states: int) -> Floats:
    """Return points (n, 6) from 0 to 1: first some spread evenly, then some that follow them, moved to the border."""
    # Of the latter, coordinates of the membrane and of the size that are near to an end are moved there: on the average
    # two of a point, so that all faces and many edges and corners have states.
    points = sobol_places(states + border_states, len(FREE_PARAMETERS))
    of_membrane = points[states:, 1:]
    of_membrane[of_membrane < _NEAR] = 0.0
    of_membrane[of_membrane > 1.0 - _NEAR] = 1.0
    return points


def membrane_places(continuation: Continuation, points: Floats) -> Floats:
    """Return the places (n, 6) where states are sought, of points (n, 6) from 0 to 1."""
    places = points.copy()
    _, size, inflation, _, hardening, _ = continuation.values(places).T
    cross_section = str(continuation.settings["cross_section"])
    low, high = lowest_ca(inflation), highest_ca(size, hardening, cross_section)
    along = continuation.axes[0]
    places[:, 0] = [along.unit(float(ca)) for ca in low * (high / low) ** places[:, 0]]
    return places


@guarded()
def build_membranes(
    name: str,
    *,
    out: str | os.PathLike[str],
    states: int | None = None,
    border_states: int | None = None,
    refinement: int = 8,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> MembraneDatabase:
    """Simulate a shipped database over flow and membrane; finished states are kept in ``OUT.parts``."""
    # States that the mesh does not resolve count as lost.
    if name not in MEMBRANES:
        raise InputError("rebuild", "name", f"one of {', '.join(MEMBRANES)}", repr(name))
    check_replaceable(Path(out))
    recipe = MEMBRANES[name]
    within = recipe.states if states is None else states
    on_border = recipe.border_states if border_states is None else border_states
    continuation = membrane_continuation(recipe.cross_section, refinement)
    places = membrane_places(continuation, spread_points(within, on_border))
    found = scattered_states(
        continuation,
        membrane_start(continuation),
        places,
        folder=f"{os.fspath(out)}.parts",
        scheduler=scheduler,
        workers=workers,
        progress=progress,
    )
    resolved = [None if state is None or abs(state.slack) > SLACK_LIMIT else state for state in found]
    database = MembraneDatabase.of(scattered_dataset(continuation, places, resolved))
    database.write(out)
    return database


def nearest_state(database: MembraneDatabase, continuation: Continuation, place: Floats) -> ScatteredState:
    """Return the state of a database next to a place (6,), see `state_of`."""
    units = continuation.places(database["values"])
    return state_of(database, continuation, int(np.argmin(np.linalg.norm(units - place, axis=1))))


def state_of(database: MembraneDatabase, continuation: Continuation, number: int) -> ScatteredState:
    """Return a state of a database by its number, on the mesh of a continuation."""
    # It is as exact as the modes are in which it is stored, which suffices to begin from.
    shape = database["mesh_mean"] + database["mesh"][number] @ database["mesh_modes"]
    if continuation.settings["refinement"] != database.settings["refinement"]:
        coarse = _continuation_of(database).simulator.problem.mesh
        shape = prolonged(shape, coarse, continuation.simulator.problem.mesh)
    unknowns = np.append(shape, [database["numbers"][number, 2], database["slack"][number]])
    place = continuation.places(database["values"][number, None])[0]
    return continuation.with_derivatives(place, unknowns)


def _continuation_of(database: MembraneDatabase) -> Continuation:
    return membrane_continuation(database.cross_section, int(database.settings["refinement"]))
