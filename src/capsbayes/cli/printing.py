"""Parts that the commands print and write alike: JSON, the model, and the files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def print_json(result: Any) -> None:
    """Print a result as JSON."""
    typer.echo(json.dumps(result, indent=2))


def model_words(name: str, sha256: str, seed: int | None = None) -> str:
    """Name the model, the start of the hash of its data, and the seed."""
    return f"Model: {name}, sha256 {sha256[:12]}{'' if seed is None else f'; seed {seed}'}."


def written_words(out: Path | None, *names: str) -> str:
    """Name the files in a folder that were written; empty without a folder."""
    return "" if out is None else f"Written to {out}: {', '.join(names)}."


def write_study(folder: Path, name: str, numbers: dict[str, Any], figure: Figure) -> None:
    """Write the numbers of a study and its figure into a folder."""
    (folder / f"{name}.json").write_text(json.dumps(numbers, indent=2) + "\n")
    figure.savefig(folder / f"{name}.png", dpi=140)
