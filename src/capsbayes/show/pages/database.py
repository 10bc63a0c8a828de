"""The page of a database: what it holds, where steady shapes exist, its maps, where it comes from."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from capsbayes.database import Database
from capsbayes.show.figures.atlas import atlas
from capsbayes.show.pages.page import page, picture
from capsbayes.show.tables import database as tables
from capsbayes.show.tables.population import status_table
from capsbayes.show.tables.table import html_table, typeset
from capsbayes.status import Status

_CAPTIONS = {
    "cases": "Every case over (Ca, a/l), and the borders of what exists.",
    "shapes": "Steady shapes over (Ca, a/l).",
    "changes": "What the effect changes.",
    "velocity": "Velocity of the capsule over that of the liquid; dots are simulated cases.",
    "velocity-surface": "The same as a surface.",
    "lengths": "Extension along the flow, length on the axis and depth of the concave rear, over l.",
}
_PIXELS = ("velocity", "velocity-surface", "lengths")  # filled contours and surfaces, too many lines for SVG


def database_page(database: Database, *, source: str = "") -> str:
    """Return a database, of which `source` is the name or the file, as a whole page in HTML, its pictures within it.

    Raises
    ------
    DatabaseError
        If no case has a steady shape.
    """
    figures = {
        name: picture(figure, f"map: {name}", typeset(_CAPTIONS[name]), fit="narrow scroll", png=name in _PIXELS)
        for name, figure in atlas(database).items()
    }
    attributes = database.dataset.attrs
    statuses = {Status[name]: count for name, count in Counter(map(str, database["status"])).most_common()}
    return page(
        "database.html",
        title=str(attributes["title"]),
        name=Path(source).stem if source else "without a name",
        headline=(
            f"{len(database.converged)} steady shapes, {attributes['law']} membrane, "
            f"{attributes['cross_section']} channel"
        ),
        domain_sentence=typeset(tables.domain_sentence(database)),
        contents=html_table(tables.contents_table(database)),
        cases=figures.pop("cases"),
        ratio=typeset("a/l"),
        domain=html_table(tables.domain_table(database)),
        statuses=html_table(status_table(statuses, "cases")),
        maps=list(figures.values()),
        origin=html_table(tables.origin_table(database, source)),
        settings=html_table(tables.settings_table(database)),
    )
