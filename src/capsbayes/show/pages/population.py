"""The page of many capsules: the histogram of G_s, G_s against a, and the table, worst first."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from capsbayes.infer.hierarchy import ModulusSpread
from capsbayes.infer.population import Population
from capsbayes.show.figures.population import (
    OTHERS,
    USABLE,
    bar_words,
    modulus_against_radius,
    modulus_histogram,
)
from capsbayes.show.pages.page import drawing, page, picture
from capsbayes.show.tables.population import capsule_table, hierarchy_table, origin_table, status_table, summary_table
from capsbayes.show.tables.table import html_table, typeset
from capsbayes.show.words import population as words
from capsbayes.show.words.rounding import with_unit

MOST_ROWS = 500
"""Capsules in the table of the page; the file holds all."""

_MANY = 500  # points beyond which a picture of pixels is smaller
_IN_THE_FILE = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio")
_KINDS = ("median", "lower_68", "upper_68", "lower_95", "upper_95")


def population_page(
    population: Population, *, spread: ModulusSpread | None = None, rows: int = MOST_ROWS, source: str = ""
) -> str:
    """Return a population as a whole page in HTML, its pictures within it.

    Drawn over the histogram is the spread of G_s with the errors removed, by default that of the population; at most
    `rows` capsules are in the table, and all of them in the file `source`.
    """
    number, used = len(population), int(population.usable.sum())
    stored = population.attributes.get("hierarchy")
    drawn = spread or ModulusSpread.of_population(population)
    distribution = spread or stored or drawn
    left_out = f"The {rows} worst of {number} are shown; the others are in {source or 'the file of the population'}."
    return page(
        "population.html",
        title=f"{number} capsules",
        headline=typeset(
            words.headline(population) if distribution is None else words.distribution_headline(distribution)
        ),
        below=[typeset(sentence) for sentence in _below(population, distribution is not None) if sentence],
        ended=words.status_words(population),
        caveats=[typeset(sentence) for sentence in (words.caveats(stored) if stored else ())],
        all_done=used == number,
        histogram=_histogram(population, drawn, used),
        summary=html_table(summary_table(population)),
        spread="" if distribution is None else typeset(words.spread_words(distribution)),
        hierarchy_title=typeset(words.hierarchy_title(stored)) if stored else "",
        hierarchy=html_table(hierarchy_table(stored)) if stored else "",
        shared=typeset(words.shared_words(stored)) if stored else "",
        missing=typeset(words.missing_words(stored)) if stored else "",
        scatter=_scatter(population),
        modulus=typeset("G_s"),
        ratio=typeset("a/l"),
        left_out=left_out if number > rows else "",
        rows=html_table(capsule_table(population, most=rows), sortable=True),
        table=_csv(population, rows),
        statuses=html_table(status_table(population.counts)),
        origin=html_table(origin_table(population, source)),
    )


def _histogram(population: Population, spread: ModulusSpread | None, used: int) -> Markup:
    caption = f"Medians of {used} capsules; the histogram is wider than their spread, for it contains the errors."
    if spread is not None:
        caption = f"Medians of {used} capsules, and how G_s itself differs from capsule to capsule."
    alternative = "histogram of the shear moduli"
    figure = modulus_histogram(population, spread)
    return drawing(figure, alternative, typeset(caption), bar_words(population), fit="narrow")


def _scatter(population: Population) -> Markup:
    caption = typeset(
        "Medians with 68 % intervals. A membrane that is the same for every size shows no trend; but the errors of "
        "both are correlated, since both follow from the same lengths."
    )
    figure = modulus_against_radius(population)
    alternative = "shear modulus against radius of each capsule"
    if len(population) > _MANY:
        return picture(figure, alternative, caption, fit="narrow", png=True)
    return drawing(figure, alternative, caption, _point_words(population), fit="narrow")


def _point_words(population: Population) -> dict[str, list[str]]:
    """Return what each point of G_s against a says, by the id of its group."""
    names = ("surface_shear_modulus", "capsule_radius")
    drawn = np.isfinite(np.stack([population[f"{name}_median"] for name in names])).all(axis=0)
    titles = population["name"] if "name" in population.dataset else np.arange(1, len(population) + 1)
    said = {}
    for group, chosen in ((USABLE, population.usable), (OTHERS, ~population.usable)):
        said[group] = [
            f"{titles[k]}: " + ", ".join(with_unit(name, float(population[f"{name}_median"][k])) for name in names)
            for k in np.flatnonzero(drawn & chosen)
        ]
    return said


def _headline(population: Population, distribution: Mapping[str, Any] | ModulusSpread | None) -> str:
    return words.headline(population) if distribution is None else words.distribution_headline(distribution)


def _below(population: Population, removed: bool) -> Iterator[str]:
    """Yield what stands below the headline: the medians with the errors in them, and the error of one capsule."""
    if removed:
        yield f"{words.headline(population)}, with the errors in them."
    yield words.width_words(population)


def _csv(population: Population, most: int) -> str:
    """Return the summaries of the capsules in the table of the page, in SI, as the address of a CSV file."""
    numbers = (f"{name}_{kind}" for name in _IN_THE_FILE for kind in _KINDS)
    along = [name for name in ("name", "status", *numbers) if name in population.dataset]
    shown = population.dataset[along].isel(capsule=population.worst_first()[:most])
    text = "".join(Population(shown).lines())
    return f"data:text/csv;base64,{base64.b64encode(text.encode()).decode()}"
