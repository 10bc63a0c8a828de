"""The page of a database and its tables: what it holds, where steady shapes end, its maps, its settings."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from capsbayes.database import LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE, NO_EFFECT, SNAP_THROUGH, Database
from capsbayes.parameters import PARAMETERS
from capsbayes.report.atlas import atlas
from capsbayes.report.page import page, picture
from capsbayes.report.population import status_table
from capsbayes.report.tables import Code, Symbols, flat, table, typeset
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


def contents_table(database: Database) -> pd.DataFrame:
    """Return law, cross-section, effect, ranges and mesh."""
    attributes, done = database.dataset.attrs, database.converged
    rows = [
        ("law of the membrane", str(attributes["law"])),
        ("cross-section of the channel", str(attributes["cross_section"])),
        ("effect", _effect(database)),
        ("bending modulus", Symbols(f"{float(attributes['bending']):g} G_s a^2")),
        ("pre-inflation", f"{float(attributes['pre_inflation']):g}"),
        ("cases", f"{len(database)}, of which {len(done)} with a steady shape"),
        (Symbols("capillary number Ca"), _range(done["capillary_number"])),
        (Symbols("size ratio a/l"), f"{_range(done['size_ratio'])}, {len(np.unique(done['size_ratio']))} columns"),
        ("mesh", f"refinement {', '.join(map(str, np.unique(database['refinement'])))}"),
        ("error of the mesh", Symbols(_mesh_error(attributes))),
    ]
    return table(("", ""), rows)


def domain_sentence(database: Database) -> str:
    """Say where steady shapes exist."""
    done = database.converged
    limits = database["border_capillary_number"][database["border_kind"] == LIMIT_OF_EXISTENCE]
    words = f"It answers for Ca {_range(done['capillary_number'])} and a/l {_range(done['size_ratio'])}"
    if len(limits):
        words += f"; beyond Ca {_range(limits)}, depending on the size, there is no steady shape"
    return f"{words}. Outside, nothing is extrapolated."


def domain_table(database: Database) -> pd.DataFrame:
    """Return where the cases of each a/l end, for each value of the effect."""
    effect = database.effect != NO_EFFECT
    head = ["a/l", "Ca from", "to", "ends at the", "snap-through at Ca"]
    rows = []
    for value in database.values:
        part = database.at_value(value)
        rows += [[f"{value:g}", *row] if effect else row for row in _columns(part)]
    if effect:
        head.insert(0, database.effect.replace("_", " "))
    numbers = range(3 + effect)
    return table([Symbols(text) for text in head], rows, numbers=numbers)


def origin_table(database: Database, source: str) -> pd.DataFrame:
    """Return source, version, date and hash."""
    attributes = database.dataset.attrs
    rows: list[tuple[str, str]] = [("file", source)] if source else []
    rows += [
        ("source", str(attributes["source"])),
        ("made by", f"capsbayes, version {attributes['version']}"),
        ("made on", str(attributes["created"])),
        ("sha256 of the content", Code(database.sha256)),
        ("read it with", Code(_reading(source))),
    ]
    return table(("", ""), rows)


def _reading(source: str) -> str:
    how = "open" if source in Database.shipped() else "read"
    return f'capsbayes.Database.{how}("{source}")'


def _effect(database: Database) -> str:
    if database.effect == NO_EFFECT:
        return "none"
    parameter = PARAMETERS.get(database.effect)
    meaning = f", {parameter.meaning}" if parameter else ""
    values = ", ".join(f"{value:g}" for value in database.values)
    return f"{database.effect.replace('_', ' ')}{meaning}: {values}; absent at {database.null_value:g}"


def _range(values: Any) -> str:
    return f"{float(np.min(values)):.3g} to {float(np.max(values)):.3g}" if len(values) else "none"


def _mesh_error(attributes: Mapping[str, Any]) -> str:
    if "mesh_error" not in attributes:
        return "not stated"
    stated = json.loads(attributes["mesh_error"])
    names = ("axial_extent", "axial_length", "velocity_ratio")
    return ", ".join(f"{PARAMETERS[name].symbol} {100.0 * stated[name]:.2g} %" for name in names if name in stated)


def _columns(part: Database) -> Iterator[list[str]]:
    done = part.converged
    sizes = np.round(done["size_ratio"], 6)
    border, kinds = np.round(part["border_size_ratio"], 6), part["border_kind"]
    for size in np.unique(np.round(part["size_ratio"], 6)):
        ca = done["capillary_number"][sizes == size]
        of_column = border == size
        ends = np.flatnonzero(of_column & np.isin(kinds, (LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE)))
        snaps = part["border_capillary_number"][of_column & (kinds == SNAP_THROUGH)]
        last = f"{part['border_capillary_number'][ends[0]]:.4g}" if len(ends) else ""
        why = str(kinds[ends[0]]).replace(" ", "\N{NO-BREAK SPACE}") if len(ends) else "no border is known"
        first = f"{ca.min():.3g}" if len(ca) else "none"
        yield [f"{size:g}", first, last, why, f"{snaps[0]:.3g}" if len(snaps) else ""]


def database_page(database: Database, *, source: str = "") -> str:
    """Return a database, of which `source` is the name or the file, as a whole page in HTML, its pictures within it."""
    figures = {
        name: picture(figure, f"map: {name}", typeset(_CAPTIONS[name]), fit="narrow scroll", png=name in _PIXELS)
        for name, figure in atlas(database).items()
    }
    statuses = {Status[name]: count for name, count in Counter(map(str, database["status"])).most_common()}
    tables = {
        "contents": contents_table(database),
        "domain": domain_table(database),
        "statuses": status_table(statuses, "cases"),
        "origin": origin_table(database, source),
        "settings": table(("", ""), flat(database.settings)),
    }
    sentence = domain_sentence(database)
    name = Path(source).stem if source else "without a name"
    return page("database.html", database=database, name=name, tables=tables, domain_sentence=sentence, figures=figures)
