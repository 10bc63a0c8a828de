"""The page of a database says what it holds, where it ends and why."""

import re
from html import unescape

import manufactured
import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.report.database import database_page, domain_sentence, domain_table
from capsbayes.report.tables import html_table
from capsbayes.status import Status


@pytest.fixture(scope="module")
def database():
    stated = {"mesh_error": manufactured.MESH_ERROR, "settings": '{"walls": {"end": 3.0}}'}
    return manufactured.database(9, 8, failed=(5, 6), **stated)


@pytest.fixture(scope="module")
def page(database):
    return database_page(database, source="manufactured.nc")


def test_each_part_is_there(database, page):
    text = re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", page)))
    parts = (
        "Database manufactured",
        "70 steady shapes, manufactured membrane, square channel",
        "72, of which 70 with a steady shape",
        "Where steady shapes exist",
        "How its cases ended",
        "2 NO_STEADY_STATE",
        str(Status.NO_STEADY_STATE),
        "Shapes and maps",
        "Origin",
        database.sha256,
        "walls: end 3",
        "How to cite",
    )
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert "L z 0.2 %, L a 0.1 %" in text
    assert page.count("<img") == 5


def test_the_domain_of_existence_is_told_column_by_column_and_value_by_value(database):
    rows = re.findall(r"<tr>(.*?)</tr>", html_table(domain_table(database)))
    assert len(rows) == 1 + 9
    last = re.findall(r"<td[^>]*>(.*?)</td>", rows[-1])
    assert last[0] == "1.15"
    assert float(last[2]) == pytest.approx(float(manufactured.limit(1.15)), rel=1e-3)
    assert last[3] == "limit\N{NO-BREAK SPACE}of\N{NO-BREAK SPACE}existence"
    limits = np.asarray(manufactured.limit(np.linspace(0.7, 1.15, 9)))
    assert f"beyond Ca {limits.min():.3g} to {limits[limits < 0.15].max():.3g}" in domain_sentence(database)
    effect = Database.open("square-unsteadiness")
    rows = re.findall(r"<tr>(.*?)</tr>", html_table(domain_table(effect)))
    columns = sum(len(np.unique(effect.at_value(value)["size_ratio"])) for value in effect.values)
    assert len(rows) == 1 + columns
    assert "unsteadiness" in rows[0]
