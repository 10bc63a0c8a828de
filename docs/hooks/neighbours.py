"""Add pages that are stored outside docs/ (data, how to contribute) to the site, and resolve links to them."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
DOCS = "docs"
NEIGHBOURS = ("data/README.md", "CONTRIBUTING.md", "CHANGELOG.md")
PICTURES = ("examples/ovalbumin/outline.png",)
LINK = re.compile(r"(?<=\]\()(?!\w+:)([^)#\s]+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the neighbours, at the same paths as in the repository."""
    for path in (*NEIGHBOURS, *PICTURES):
        files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between docs/ and its neighbours, which hold in the repository, into links of the site."""
    here = page.file.src_uri
    lies = here if here in NEIGHBOURS else f"{DOCS}/{here}"

    def resolved(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(lies), link[1]))
        on_site = target.removeprefix(f"{DOCS}/")
        if files.get_file_from_path(on_site) is None:
            return link[1]  # the strict build reports a link that leads nowhere
        return posixpath.relpath(on_site, posixpath.dirname(here) or ".")

    return LINK.sub(resolved, markdown)
