"""Run the notebooks of docs/notebooks, and make a page of each with what it printed."""

from __future__ import annotations

from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "docs" / "notebooks"
_LONGEST = 600  # s, of a cell


def executed(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with the outputs of its cells, run in the folder of the project."""
    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(ROOT)}}
    return NotebookClient(notebook, timeout=_LONGEST, kernel_name="python3", resources=where).execute()


def page_of(path: Path) -> str:
    """Return the page of a notebook in Markdown."""
    text, _ = MarkdownExporter().from_notebook_node(executed(path))
    return f"{text.rstrip()}\n\n[This notebook]({path.name}) as a file.\n"
