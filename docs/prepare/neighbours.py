"""The pages of the site that are stored outside docs/ (data, results, how to contribute), and the links to them."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Container
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = "docs"
RESULTS = "evidence/results"
NEIGHBOURS = ("data/README.md", "CONTRIBUTING.md", "CHANGELOG.md")
PICTURES = ("examples/ovalbumin/outline.png",)
LINK = re.compile(r"(?<=\]\()(?!\w+:)([^)#\s]+)")


def with_links(markdown: str, here: str, site: Container[str]) -> str:
    """Turn links between docs/ and its neighbours, which hold in the repository, into links of the site.

    The page is stored in the site at `here`; a link to a file that is not in the site stays as it is, and the strict
    build reports it.
    """
    lies = here if here in NEIGHBOURS or here.startswith(RESULTS) else f"{DOCS}/{here}"

    def resolved(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(lies), link[1]))
        on_site = target.removeprefix(f"{DOCS}/")
        return posixpath.relpath(on_site, posixpath.dirname(here) or ".") if on_site in site else link[1]

    return LINK.sub(resolved, markdown)
