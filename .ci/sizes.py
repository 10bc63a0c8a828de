"""Print how many files and lines there are, and words of the pages, beside those that were recorded (sizes.json)."""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEPT = Path(__file__).with_name("sizes.json")
PARTS = {"src": "src/**/*.py", "tests": "tests/**/*.py", "evidence": "evidence/**/*.py", "pages": "docs/**/*.md"}


def sizes() -> dict[str, list[int]]:
    """Return files and lines of each part; of the pages, files and words."""
    texts = {part: [path.read_text("utf-8") for path in ROOT.glob(pattern)] for part, pattern in PARTS.items()}
    return {
        part: [len(of), sum(len(text.split() if part == "pages" else text.splitlines()) for text in of)]
        for part, of in texts.items()
    }


if __name__ == "__main__":
    now, before = sizes(), json.loads(KEPT.read_text())
    if "--record" in sys.argv:
        KEPT.write_text(json.dumps(now, indent=2) + "\n")
    for part, (files, length) in now.items():
        unit = "words" if part == "pages" else "lines"
        print(f"{part}: {files} files, {length} {unit}; recorded were {before[part][0]} and {before[part][1]}")
