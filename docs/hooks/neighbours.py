"""Pages that live beside docs/ (data, how to contribute) as pages of the site, and links to them from others."""

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
    """Add the neighbours, at the same places as in the repository."""
    for path in (*NEIGHBOURS, *PICTURES):
        files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between docs/ and its neighbours, which hold in the repository, into links of the site."""
    here = page.file.src_uri
    lies = here if here in NEIGHBOURS else f"{DOCS}/{here}"

    def turned(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(lies), link[1]))
        on_site = target.removeprefix(f"{DOCS}/")
        if files.get_file_from_path(on_site) is None:
            return link[1]  # strict building says what it does not lead to
        return posixpath.relpath(on_site, posixpath.dirname(here) or ".")

    return LINK.sub(turned, markdown)
