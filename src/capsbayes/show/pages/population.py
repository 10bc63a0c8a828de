"""The page of many capsules: the histogram of G_s, G_s against a, and the table, worst first."""

from __future__ import annotations

from markupsafe import Markup

from capsbayes.infer.many import Population
from capsbayes.infer.many.distribution.modulus_spread import ModulusSpread
from capsbayes.show.figures.population import modulus_against_radius, modulus_histogram
from capsbayes.show.pages.page import page, picture
from capsbayes.show.tables.population import capsule_table, hierarchy_table, origin_table, status_table, summary_table
from capsbayes.show.tables.table import html_table, typeset
from capsbayes.show.words import population as words

MOST_ROWS = 500
"""Capsules in the table of the page; the file holds all."""

_MANY = 2000  # points beyond which a picture of pixels is smaller


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
        headline=typeset(words.headline(population)),
        below=typeset(words.width_words(population)),
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
        left_out=left_out if number > rows else "",
        rows=html_table(capsule_table(population, most=rows), sortable=True),
        statuses=html_table(status_table(population.counts)),
        origin=html_table(origin_table(population, source)),
    )


def _histogram(population: Population, spread: ModulusSpread | None, used: int) -> Markup:
    caption = f"Medians of {used} capsules; the histogram is wider than their spread, for it contains the errors."
    if spread is not None:
        caption = f"Medians of {used} capsules, and how G_s itself differs from capsule to capsule."
    alternative = "histogram of the shear moduli"
    return picture(modulus_histogram(population, spread), alternative, typeset(caption), fit="narrow")


def _scatter(population: Population) -> Markup:
    caption = typeset(
        "Medians with 68 % intervals. A membrane that is the same for every size shows no trend; but the errors of "
        "both are correlated, since both follow from the same lengths."
    )
    figure = modulus_against_radius(population)
    alternative = "shear modulus against radius of each capsule"
    return picture(figure, alternative, caption, fit="narrow", png=len(population) > _MANY)
