"""Recipes of the shipped databases."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.physics.build import (
    Cases,
    SteadySimulator,
    build_database,
    default_grid,
    effect_grid,
    parachute_grid,
    stiffening_grid,
    wide_grid,
)
from capsbayes.physics.membrane import GeneralisedHooke, HookeShare, NeoHookean, Skalak, StrainHardening
from capsbayes.physics.simulator import Simulator, UnsteadySimulator


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
    return Recipe(replace(mesh, cross_section=cross_section, law=_LAWS[law]), effect_grid(), effect, values)


RECIPES: dict[str, Recipe] = {
    "square-neo-hookean": _plain("square", "neo-hookean", default_grid()),
    "circular-neo-hookean": _plain("circular", "neo-hookean", default_grid()),
    **{
        f"{cross_section}-{law}": _plain(cross_section, law, stiffening_grid())
        for cross_section in ("square", "circular")
        for law in ("skalak", "hooke")
    },
    # inflation moves the snap-through and the limit of existence, and with them the coarse mesh's error
    "square-pre-inflation": Recipe(_MEDIUM, wide_grid(), "pre_inflation", _INFLATIONS),
    "circular-pre-inflation": Recipe(
        replace(_COARSE, cross_section="circular"), wide_grid(), "pre_inflation", _INFLATIONS
    ),
    "square-hardening": _effect("hardening", 0.1, 0.3, 1.0, 3.0, 10.0, law="skalak"),
    # strain hardening and bending round the sharp rim, and with it the coarse mesh's error is not the same
    "square-strain-hardening": _effect("strain_hardening", 0.0, 0.25, 0.5, 1.0, law="strain-hardening", mesh=_FINE),
    "square-hooke-share": _effect("hooke_share", 0.0, 0.25, 0.5, 1.0, law="hooke-share", mesh=_FINE),
    "square-bending": _effect("bending", 5e-5, 2e-4, 5e-4, 1e-3, 1.7e-3, 3e-3, mesh=_FINE),
    "square-rest-aspect": _effect("rest_aspect", 0.9, 0.95, 1.0, 1.05, 1.1),
    "square-corner-radius": _effect("corner_radius", 0.0, 0.05, 0.1, 0.15, 0.2),
    "square-unsteadiness": Recipe(
        UnsteadySimulator(_COARSE), parachute_grid(), "unsteadiness", (0.0, 0.5, 1.0, 1.5, 2.0)
    ),
    "square-section-aspect": replace(
        _effect("section_aspect", 0.9, 0.95, 1.0, 1.05, 1.1, cross_section="rectangular"), cases=parachute_grid()
    ),
}
"""By name of the database."""


def recipe_named(name: str) -> Recipe:
    """Return the recipe of one database; refuse an unknown name."""
    if name not in RECIPES:
        raise InputError("recipe", "", f"one of {', '.join(RECIPES)}", repr(name))
    return RECIPES[name]


def build_shipped(
    name: str,
    *,
    out: str | os.PathLike[str],
    full: bool = False,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Database:
    """Build a database that comes with the library, compact unless `full`, see `Database.compact`."""
    recipe = recipe_named(name)
    return build_database(
        recipe.simulator,
        recipe.cases,
        out=out,
        effect=recipe.effect,
        values=recipe.values,
        scheduler=scheduler,
        workers=workers,
        progress=progress,
        compare=recipe.compare,
        compact=not full,
    )
