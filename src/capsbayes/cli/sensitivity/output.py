"""How the commands of ``capsbayes sensitivity`` show their progress and write their files."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def progress(points: Iterable, number: int, what: str) -> Iterable:
    """Bar over what is worked on, on a terminal only."""
    if not sys.stderr.isatty():
        return points
    from rich.console import Console
    from rich.progress import track

    return track(points, what, total=number, console=Console(stderr=True), transient=True)


def as_json(found: dict[str, Any]) -> str:
    """A result as text of JSON."""
    return json.dumps(found, indent=2)


def write_study(folder: Path, name: str, found: dict[str, Any], figure: Figure) -> None:
    """Write the numbers of a study and its picture into a folder."""
    (folder / f"{name}.json").write_text(as_json(found) + "\n")
    figure.savefig(folder / f"{name}.png", dpi=140)
