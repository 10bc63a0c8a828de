"""Run the notebooks of docs/notebooks, and make a page of each with what it printed and drew."""

from __future__ import annotations

from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
_LONGEST = 600  # s, of a cell
_QUIET = ["--log-level=ERROR"]  # without what a kernel says of its connection to this process


def executed(path: Path) -> nbformat.NotebookNode:
    """Return a notebook with the outputs of its cells, run in its own folder, as Jupyter does."""
    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(path.parent)}}
    return NotebookClient(
        notebook, timeout=_LONGEST, kernel_name="python3", resources=where, extra_arguments=_QUIET
    ).execute()


def page_of(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return the page of a notebook in Markdown, and the files of its pictures."""
    text, made = MarkdownExporter().from_notebook_node(executed(path), resources={"unique_key": path.stem})
    text = text.rstrip().replace(".ipynb)", ".md)")  # links to other notebooks
    return f"{text}\n\n[This notebook]({path.name}) as a file.\n", made["outputs"]
