"""The notebooks run, end where they should, and are kept without outputs."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SHOWN = {
    "one-capsule": (r"G_s = ([\d.]+) \[", 50.0, 2.0),
    "population": (r"surface_shear_modulus\D+([\d.]+) \[", 50.0, 4.0),
    "hidden-effect": (r"0\.60 µL/min, \d+ capsules: [\d.]+, ([\d.]+)", 50.0, 6.0),
}
"""What a notebook prints, the truth, and how far from it the number may be."""


def test_there_are_three_and_they_are_kept_without_outputs():
    nbformat = pytest.importorskip("nbformat", reason="the notebooks need what the extra docs installs")
    assert {path.stem for path in NOTEBOOKS} == set(SHOWN)
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_ends_with_where_to_go_on_and_its_links_lead_somewhere(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    words = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    assert "## Where to go on" in words[-1]
    links = re.findall(r"\]\((?!\w+:)([^)#]+)", "\n".join(words))
    assert len(links) >= 3
    assert all((path.parent / link).exists() for link in links), links


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning:jupyter_client", "ignore::DeprecationWarning:zmq")
def test_a_notebook_runs_and_finds_the_truth(path):
    pytest.importorskip("nbconvert", reason="the notebooks need what the extra docs installs")
    spec = importlib.util.spec_from_file_location("notebooks", ROOT / "docs" / "prepare" / "notebooks.py")
    pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pages)
    page, pictures = pages.page_of(path)
    pattern, truth, off = SHOWN[path.stem]
    found = re.search(pattern, page)
    assert found is not None, page
    assert float(found[1]) == pytest.approx(truth, abs=off)
    assert len(pictures) == 1
    assert all(name in page and content.startswith(b"\x89PNG") for name, content in pictures.items())
