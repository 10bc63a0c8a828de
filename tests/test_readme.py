"""The gate runs each shell block of the README and nothing else; its Python runs, and its figures are those counted."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from evidence.benchmarks import population_coverage, silhouettes

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCRIPT = ROOT / ".ci" / "blocks.py"


def test_the_gate_takes_every_shell_block_and_each_makes_its_own_environment(tmp_path):
    subprocess.run([sys.executable, SCRIPT, ROOT / "README.md", tmp_path], check=True)
    taken = [path.read_text(encoding="utf-8") for path in sorted(tmp_path.iterdir())]
    assert len(taken) == README.count("\n```sh\n") == README.count("```") // 2 - README.count("\n```python\n") >= 3
    assert all(f"\n```sh\n{text}```\n" in README for text in taken)
    assert all(text.startswith("python3 -m venv .venv && .venv/bin/pip install --quiet") for text in taken)
    assert sum("pytest" in text for text in taken) == sum("mkdocs build --strict" in text for text in taken) == 1


@pytest.mark.parametrize(
    "text",
    [
        "No block.\n",
        "```sh\nnever closed\n",
        "```sh\n```\n",
        "```sh\none\n```\n\n```python\nnever closed\n",
        "```sh\nfirst && one\nsecond\n```\n",
        "```sh\none\n```\n\n```bash\nanother kind\n```\n",
        "```sh\none\n```\n\n- in a list\n\n    ```sh\n    another\n    ```\n",
    ],
)
def test_what_would_be_missed_is_an_error(text):
    with pytest.raises(ValueError, match="expected"):
        runpy.run_path(str(SCRIPT))["blocks"](text)


def test_the_python_prints_an_interval_that_holds_the_truth(tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    script = re.search(r"\n```python\n(.*?)```\n", README, re.DOTALL)[1]
    done = subprocess.run([sys.executable, "-c", script], check=True, cwd=tmp_path, capture_output=True, text=True)
    median, low, high = (float(number) for number in re.findall(r"0\.\d+", done.stdout))
    assert 0.045 < low < median < high < 0.055
    assert low < 0.05 < high
    assert (tmp_path / "corner.png").stat().st_size > 1000


def test_the_figures_of_coverage_are_those_of_the_last_run():
    """Those of blind sessions are compared with the answers of the exam."""
    pictures = [row["silhouette"] for row in silhouettes.STORED.read().values()]
    held, drawn = sum(round(row["95%"][0] * row["n"]) for row in pictures), sum(row["n"] for row in pictures)
    sessions = population_coverage.STORED.read()["lost"]
    words = " ".join(README.split())
    assert f"in {held} of {drawn} [drawn pictures]" in words
    assert f"in {sessions['surface_shear_modulus 95']} of {sessions['sessions']} [sessions]" in words
