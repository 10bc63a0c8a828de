"""Writers of the files of a result."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from capsbayes.files.output_file import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from capsbayes.infer import Posterior


Writer = Callable[[Path], object]


def posterior_summary(posterior: Posterior) -> dict[str, Any]:
    """Return everything but the draws, with how much the prior matters."""
    return {**posterior.as_dict(), "prior_sensitivity": posterior.prior_sensitivity}


def posterior_files(posterior: Posterior) -> dict[str, Writer]:
    """Return the writers of all files of an identified capsule by the names of the files."""
    files: dict[str, Writer] = {
        "posterior.nc": posterior.write,
        "summary.json": lambda path: json_file(posterior_summary(posterior))(path),
        "corner.png": figure_file(lambda: _figures().corner_of_all(posterior), dpi=110),
    }
    if posterior.outlines is not None:
        files["outline.png"] = figure_file(lambda: _figures().outline_figure(posterior), dpi=200)
    if posterior.resimulation is not None:
        files["simulator.png"] = figure_file(lambda: _figures().resimulation_figure(posterior.resimulation))
    return files


def _figures() -> ModuleType:
    from capsbayes.report import posterior_figures  # half a second, where no figure is asked for

    return posterior_figures


def json_file(result: Any) -> Writer:
    """Return a function that writes a result into a JSON file."""
    return lambda path: write_file(path, json.dumps(result, indent=2) + "\n")


def figure_file(draw: Callable[[], Figure], dpi: int = 140) -> Writer:
    """Return a function that draws a figure into a file."""

    def write(path: Path) -> None:
        from capsbayes.report.style import write_figure

        write_figure(draw(), path, dpi)

    return write
