"""What is printed of many capsules."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from capsbayes.infer.hierarchy import Hierarchy
from capsbayes.infer.population import Population
from capsbayes.show.tables import population as of_population
from capsbayes.show.tables.table import Strong
from capsbayes.show.words import population as population_words

Parts = Iterator[str | pd.DataFrame]


def population_parts(population: Population) -> Parts:
    """Yield what is printed of many capsules."""
    yield Strong(population_words.headline(population))
    yield population_words.width_words(population)
    yield population_words.status_words(population)
    yield of_population.status_table(population.counts)
    yield of_population.summary_table(population)


def hierarchy_parts(hierarchy: Hierarchy) -> Parts:
    """Yield what is printed of the population that the capsules come from."""
    stored = hierarchy.as_dict()
    yield of_population.hierarchy_table(stored)
    yield population_words.spread_words(stored)
    yield population_words.shared_words(stored)
    yield population_words.missing_words(stored)
    yield from population_words.caveats(stored)
