"""The benchmarks of a few minutes, one after the other, each in a process of its own: ``python benchmarks/run.py``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

NAMES = (
    "pictures",
    "films",
    "surrogate",
    "off_nodes",
    "inference",
    "outline",
    "sensitivity",
    "populations",
    "simulator",
)


def main() -> int:
    here = Path(__file__).parent
    status = 0
    for name in NAMES:
        print(f"\n== {name}", flush=True)
        status |= subprocess.run([sys.executable, str(here / f"{name}.py")], check=False).returncode
    return status


if __name__ == "__main__":
    sys.exit(main())
