"""What a terminal prints, compared with a page."""

import re
from html import unescape

import pandas as pd

from capsbayes.report.tables import typeset


def plain(html):
    """The text of HTML without its tags."""
    return " ".join(unescape(re.sub(r"<[^>]+>", "", html)).split())


def cells_of(page):
    """The texts of each row of each table."""
    rows = re.findall(r"<tr>(.*?)</tr>", page, flags=re.S)
    return {tuple(plain(cell) for cell in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row, flags=re.S)) for row in rows}


def assert_same(parts, page, *, but=()):
    """Each sentence and each row of each table that is printed stands on the page."""
    text, rows = plain(page), cells_of(page)
    for part in parts:
        if isinstance(part, pd.DataFrame):
            known = {tuple(plain(typeset(cell)) for cell in row) for row in rows} | rows
            for row in part.itertuples(index=False, name=None):
                assert tuple(plain(typeset(cell)) for cell in row) in known, row
        else:
            for line in part.splitlines():
                assert line in but or plain(typeset(line)) in text, line
