"""The shell blocks of the README, which the gate runs: ``python3 .ci/blocks.py README.md FOLDER`` writes a script each.

Blocks of Python are left to the tests, which run them. Whatever it could miss is an error: a fence of another kind, a
block without an end, and a second command in a block, whose exit status would hide that of the first.
"""

from __future__ import annotations

import sys
from pathlib import Path


def blocks(markdown: str) -> list[str]:
    """Return the text of each shell block; each is one command."""
    found: list[str] = []
    block: list[str] | None = None
    shell = True
    for number, line in enumerate(markdown.splitlines(), start=1):
        if not line.lstrip(" >").startswith(("```", "~~~")):
            if block is not None:
                block.append(line)
        elif block is None:
            if line not in ("```sh", "```python"):
                raise ValueError(f"line {number}: expected a block that begins with ```sh or ```python, got {line}")
            shell, block = line == "```sh", []
        else:
            text = "\n".join(block)
            if line != "```" or not text.strip() or (shell and "\n" in text.replace("\\\n", " ").strip()):
                raise ValueError(f"line {number}: expected the end of a block of one command")
            found += [text] if shell else []
            block = None
    if block is not None or not found:
        raise ValueError("expected blocks of shell commands, each with an end")
    return found


if __name__ == "__main__":
    for number, text in enumerate(blocks(Path(sys.argv[1]).read_text(encoding="utf-8")), start=1):
        Path(sys.argv[2], f"{number}.sh").write_text(f"{text}\n", encoding="utf-8")
