"""The page of a database and its tables: what it holds, where steady shapes end, its maps, its settings."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from capsbayes.database import LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE, NO_EFFECT, SNAP_THROUGH, Database
from capsbayes.parameters import PARAMETERS
from capsbayes.report.atlas import atlas
from capsbayes.report.page import page
from capsbayes.report.population import status_table
from capsbayes.report.tables import Code, Symbols, flat, table
from capsbayes.status import Status


def database_page(database: Database, *, source: str = "") -> str:
    """Return a database, of which `source` is the name or the file, as a whole page in HTML, its pictures within it."""
    statuses = {Status[name]: count for name, count in Counter(map(str, database["status"])).most_common()}
    tables = {
        "contents": contents_table(database),
        "domain": domain_table(database),
        "statuses": status_table(statuses, "cases"),
        "origin": origin_table(database, source),
        "settings": table(("", ""), flat(database.settings)),
    }
    words = {"name": Path(source).stem if source else "without a name", "domain_sentence": domain_sentence(database)}
    return page("database.html", database=database, tables=tables, figures=atlas(database), **words)


def contents_table(database: Database) -> pd.DataFrame:
    """Return law, cross-section, effect, ranges and mesh."""
    attributes, done = database.dataset.attrs, database.converged
    effect = "none"
    if database.effect != NO_EFFECT:
        known, values = PARAMETERS.get(database.effect), ", ".join(f"{value:g}" for value in database.values)
        effect = database.effect.replace("_", " ") + (f", {known.meaning}" if known else "")
        effect += f": {values}; absent at {database.null_value:g}"
    mesh_error = "not stated"
    if "mesh_error" in attributes:
        errors = json.loads(attributes["mesh_error"])
        names = [name for name in ("axial_extent", "axial_length", "velocity_ratio") if name in errors]
        mesh_error = ", ".join(f"{PARAMETERS[name].symbol} {100.0 * errors[name]:.2g} %" for name in names)
    rows = [
        ("law of the membrane", str(attributes["law"])),
        ("cross-section of the channel", str(attributes["cross_section"])),
        ("effect", effect),
        ("bending modulus", Symbols(f"{float(attributes['bending']):g} G_s a^2")),
        ("pre-inflation", f"{float(attributes['pre_inflation']):g}"),
        ("cases", f"{len(database)}, of which {len(done)} with a steady shape"),
        (Symbols("capillary number Ca"), _range(done["capillary_number"])),
        (Symbols("size ratio a/l"), f"{_range(done['size_ratio'])}, {len(np.unique(done['size_ratio']))} columns"),
        ("mesh", f"refinement {', '.join(map(str, np.unique(database['refinement'])))}"),
        ("error of the mesh", Symbols(mesh_error)),
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
    head = [database.effect.replace("_", " ")] * effect
    head += ["a/l", "Ca from", "to", "ends at the", "snap-through at Ca"]
    rows = [[f"{value:g}"] * effect + row for value in database.values for row in _columns(database.at_value(value))]
    return table([Symbols(text) for text in head], rows, numbers=range(3 + effect))


def _columns(part: Database) -> Iterator[list[str]]:
    """Yield a row of `domain_table` for each a/l."""
    done = part.converged
    border, kinds = np.round(part["border_size_ratio"], 6), part["border_kind"]
    for size in np.unique(np.round(part["size_ratio"], 6)):
        ca = done["capillary_number"][np.round(done["size_ratio"], 6) == size]
        ends = np.flatnonzero((border == size) & np.isin(kinds, (LIMIT_OF_DATABASE, LIMIT_OF_EXISTENCE)))
        snaps = part["border_capillary_number"][(border == size) & (kinds == SNAP_THROUGH)]
        last = f"{part['border_capillary_number'][ends[0]]:.4g}" if len(ends) else ""
        why = str(kinds[ends[0]]).replace(" ", "\N{NO-BREAK SPACE}") if len(ends) else "no border is known"
        first = f"{ca.min():.3g}" if len(ca) else "none"
        yield [f"{size:g}", first, last, why, f"{snaps[0]:.3g}" if len(snaps) else ""]


def origin_table(database: Database, source: str) -> pd.DataFrame:
    """Return source, version, date and hash."""
    attributes = database.dataset.attrs
    how = "open" if source in Database.shipped() else "read"
    rows: list[tuple[str, str]] = [("file", source)] if source else []
    rows += [
        ("source", str(attributes["source"])),
        ("made by", f"capsbayes, version {attributes['version']}"),
        ("made on", str(attributes["created"])),
        ("sha256 of the content", Code(database.sha256)),
        ("read it with", Code(f'capsbayes.Database.{how}("{source}")')),
    ]
    return table(("", ""), rows)


def _range(values: Any) -> str:
    return f"{float(np.min(values)):.3g} to {float(np.max(values)):.3g}" if len(values) else "none"
