"""Write the files of the commands of ``capsbayes sensitivity``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def as_json(found: dict[str, Any]) -> str:
    """Return a result as JSON text."""
    return json.dumps(found, indent=2)


def write_study(folder: Path, name: str, found: dict[str, Any], figure: Figure) -> None:
    """Write the numbers of a study and its picture into a folder."""
    (folder / f"{name}.json").write_text(as_json(found) + "\n")
    figure.savefig(folder / f"{name}.png", dpi=140)
