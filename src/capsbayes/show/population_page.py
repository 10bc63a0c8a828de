"""The page of many capsules: the histogram of G_s, G_s against a, and the table, worst first."""

from __future__ import annotations

import numpy as np
import xarray as xr
from markupsafe import Markup

from capsbayes.parameters import PARAMETERS
from capsbayes.show.page import page, picture, table, typeset
from capsbayes.show.population_plots import modulus_against_radius, modulus_histogram
from capsbayes.show.population_rows import (
    MODULUS,
    check_population,
    column,
    done,
    row_table,
    status_table,
)
from capsbayes.show.rounding import decimals, per_cent, rounded, together, unit_of
from capsbayes.show.spread import Spread

__all__ = ["MOST_ROWS", "population_page"]

MOST_ROWS = 500
"""Capsules in the table of the page; the file holds all."""

_MODULUS = PARAMETERS[MODULUS]
_MANY = 2000  # points beyond which a picture of pixels is smaller


def population_page(
    population: xr.Dataset, *, spread: Spread | None = None, rows: int = MOST_ROWS, source: str = ""
) -> str:
    """Write a population as HTML.

    Parameters
    ----------
    population : Dataset
        One row a capsule, dimension ``capsule``: ``status``, the name of a `Status`; for each quantity of
        `capsbayes.parameters` that is known, ``<name>_median``, ``_lower_68``, ``_upper_68``, ``_lower_95``,
        ``_upper_95``, in SI, NaN where a capsule came to nothing; optionally ``name``. Its attributes say where it
        comes from.
    spread : Spread, optional
        Of G_s with the errors removed, drawn over the histogram; by default the one that the population holds.
    rows : int
        At most so many capsules in the table.
    source : str
        File that holds all of them.

    Returns
    -------
    str
        A whole page; its pictures are within it.

    Raises
    ------
    InputError
        If it is no such dataset.
    """
    check_population(population, source or "population")
    number, used = population.sizes["capsule"], int(done(population).sum())
    spread = spread or Spread.stored(population)
    return page(
        "population.html",
        title=f"{number} capsules",
        headline=typeset(_headline(population)),
        below=typeset(_below(population)),
        ended=_ended(number, used),
        all_done=used == number,
        histogram=_histogram(population, spread, used),
        spread="" if spread is None else typeset(_spread_words(spread)),
        scatter=_scatter(population),
        modulus=typeset(_MODULUS.symbol),
        left_out=_left_out(number, rows, source),
        rows=row_table(population, most=rows),
        statuses=status_table(population),
        origin=_origin(population, source),
    )


def _headline(population: xr.Dataset) -> str:
    medians = column(population, MODULUS, "median")[done(population)]
    medians = medians[np.isfinite(medians)]
    if not len(medians):
        return "No capsule could be identified."
    low, middle, high = (_MODULUS.shown(one) for one in np.quantile(medians, [0.025, 0.5, 0.975]))
    digits = decimals(max(0.25 * (high - low), 1e-3 * middle))
    unit, (shown, *ends) = unit_of(_MODULUS), together((middle, low, high), digits)
    return f"Median G_s = {shown}{unit}, 95 % of the capsules from {' to '.join(ends)}{unit}"


def _below(population: xr.Dataset) -> str:
    """How well one capsule is known, beside how much they differ."""
    use = done(population)
    low, high = (column(population, MODULUS, kind)[use] for kind in ("lower_95", "upper_95"))
    seen = np.isfinite(low) & np.isfinite(high)
    if not seen.any():
        return ""
    half = float(np.median(0.5 * np.log(high[seen] / low[seen])))
    return f"Median of {int(seen.sum())} capsules; the 95 % interval of one of them is typically ± {per_cent(half)}."


def _ended(number: int, used: int) -> str:
    if used == number:
        return f"All {number} capsules ended as they should."
    others = "the other one is" if number - used == 1 else f"the other {number - used} are"
    return (
        f"{used} of {number} capsules ended as they should; {others} left out of the histogram and the numbers above."
    )


def _histogram(population: xr.Dataset, spread: Spread | None, used: int) -> Markup:
    caption = f"Medians of {used} capsules; the histogram is wider than the capsules differ, for errors are in it."
    if spread is not None:
        caption = f"Medians of {used} capsules, and how {_MODULUS.symbol} itself differs from capsule to capsule."
    alternative = "histogram of the shear moduli"
    return picture(modulus_histogram(population, spread), alternative, typeset(caption), fit="narrow")


def _scatter(population: xr.Dataset) -> Markup:
    caption = typeset(
        "Medians with 68 % intervals. A membrane that is the same for every size shows no trend; but the errors of "
        "both are correlated, since both follow from the same lengths."
    )
    figure = modulus_against_radius(population)
    many = population.sizes["capsule"] > _MANY
    return picture(figure, "shear modulus against radius of each capsule", caption, fit="narrow", png=many)


def _spread_words(spread: Spread) -> str:
    low, middle, high = (_MODULUS.shown(one) for one in spread.median[[1, 0, 2]])
    digits = decimals(0.25 * (high - low) or 1e-3 * middle)
    known = f", 95 % [{rounded(low, digits)}, {rounded(high, digits)}]" if high > low else ""
    middle_sd, low_sd, high_sd = spread.relative
    band = f", 95 % [{per_cent(low_sd)}, {per_cent(high_sd)}]" if high_sd > low_sd else ""
    return (
        f"With the errors removed, the median G_s of the capsules is {rounded(middle, digits)}{unit_of(_MODULUS)}"
        f"{known}, and they differ from it by {per_cent(middle_sd)} (standard deviation of ln G_s{band})."
    )


def _left_out(number: int, rows: int, source: str) -> str:
    if number <= rows:
        return ""
    return f"The {rows} worst of {number} are shown; the others are in {source or 'the file of the population'}."


def _origin(population: xr.Dataset, source: str) -> Markup:
    """File and attributes, those of few words first."""
    lines = [("file", source)] if source else []
    lines += [(name.replace("_", " "), str(value)) for name, value in population.attrs.items()]
    shown = [(name, Markup("<code>{}</code>").format(value) if _coded(value) else value) for name, value in lines]
    return table((), shown)


def _coded(value: str) -> bool:
    return (len(value) > 40 and " " not in value.strip()) or value.lstrip().startswith(("{", "["))
