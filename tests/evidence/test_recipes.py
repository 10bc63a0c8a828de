import json

import pytest

from capsbayes import Database
from capsbayes.errors import InputError
from capsbayes.physics.simulator import Simulator
from evidence.rebuild import RECIPES, recipe_named

FINER = {"square-strain-hardening": 12, "square-hooke-share": 12, "square-bending": 12, "square-pre-inflation": 10}
"""Effects with which the error of a coarse mesh changes."""


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_can_be_followed(name):
    recipe = recipe_named(name)
    simulator = getattr(recipe.simulator, "simulator", recipe.simulator)  # of a capsule that is still on the way
    assert isinstance(simulator, Simulator)
    assert len(set(recipe.cases)) == len(recipe.cases) >= 60
    if recipe.effect:
        owner = recipe.simulator if hasattr(recipe.simulator, recipe.effect) else recipe.simulator.law
        assert getattr(owner, recipe.effect) in recipe.values
        assert simulator.refinement == FINER.get(name, 8)
    else:
        assert len(recipe.cases) >= 200
        assert simulator.refinement == 12


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_has_the_settings_of_the_database_that_was_made_with_it(name):
    stored = json.loads(Database.open(name).dataset.attrs["settings"])
    assert json.loads(json.dumps(recipe_named(name).simulator.settings)) == stored


def test_pre_inflation_covers_the_whole_range():
    for section in ("square", "circular"):
        recipe = recipe_named(f"{section}-pre-inflation")
        assert min(ca for ca, _ in recipe.cases) == 0.003
        assert recipe.values == (0.0, 0.01, 0.025, 0.05, 0.1)


def test_unknown_recipe_names_those_there_are():
    with pytest.raises(InputError, match=r"recipe: expected one of square-neo-hookean, .*, got 'oval'"):
        recipe_named("oval")
