"""The table of omitted effects is that of what was computed, and computing it again gives the same."""

import json

import pytest

from capsbayes import Surrogate
from evidence.benchmarks import omitted_effects


@pytest.fixture(scope="module")
def found():
    return json.loads(omitted_effects.STORED.read_text())


def test_the_page_shows_the_stored_table(found):
    begin, end = omitted_effects.BEGIN, omitted_effects.END
    assert omitted_effects.PAGE.read_text().partition(begin)[2].partition(end)[0] == omitted_effects.table(found)
    assert found.keys() == {cell.name for cell in omitted_effects.cells()}


@pytest.mark.parametrize("effect", ["pre_inflation", "pixel_scale"])
def test_what_is_stored_is_what_is_computed(found, effect):
    cell = next(cell for cell in omitted_effects.cells() if cell.effect == effect)
    again = omitted_effects.omitted(cell, Surrogate.open("square-neo-hookean"))
    assert again == pytest.approx(found[cell.name], rel=0.01, abs=1e-4)
    assert found[cell.name]["log_modulus"] > 0.0
