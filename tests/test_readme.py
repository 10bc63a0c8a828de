"""The gate runs each shell block of the README, and nothing that a reader would not run."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCRIPT = ROOT / ".ci" / "blocks.py"


def test_the_gate_takes_every_shell_block_and_each_makes_its_own_environment(tmp_path):
    subprocess.run([sys.executable, SCRIPT, ROOT / "README.md", tmp_path], check=True)
    taken = [path.read_text(encoding="utf-8") for path in sorted(tmp_path.iterdir())]
    assert len(taken) == README.count("```") // 2 == README.count("\n```sh\n") >= 3
    assert all(f"\n```sh\n{text}```\n" in README for text in taken)
    assert all(text.startswith("python3 -m venv .venv && .venv/bin/pip install --quiet") for text in taken)
    assert sum("pytest" in text for text in taken) == sum("mkdocs build --strict" in text for text in taken) == 1


@pytest.mark.parametrize(
    "text",
    [
        "No block.\n",
        "```sh\nnever closed\n",
        "```sh\n```\n",
        "```sh\nfirst && one\nsecond\n```\n",
        "```sh\none\n```\n\n```bash\nanother kind\n```\n",
        "```sh\none\n```\n\n- in a list\n\n    ```sh\n    another\n    ```\n",
    ],
)
def test_what_would_be_missed_is_an_error(text):
    with pytest.raises(ValueError, match="expected"):
        runpy.run_path(str(SCRIPT))["blocks"](text)
