"""Every picture of the pages is shown, and those that are renewed by a command are among them."""

import re
from pathlib import Path

from evidence.pictures import PICTURES

ROOT = Path(__file__).parents[2]
KEPT = {path.name for path in (ROOT / "docs" / "pictures").iterdir()}


def test_pages_show_every_picture_that_is_kept():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    assert set(re.findall(r"(?:\(|docs/)pictures/([\w.-]+)", text)) == KEPT


def test_the_pictures_that_are_renewed_are_kept():
    assert {f"{name}.png" for name in PICTURES} <= KEPT
