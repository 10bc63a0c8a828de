"""The single layer on a sphere, where it is known in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from capsbayes.evidence.verification.rates import fitted_rate
from capsbayes.evidence.verification.row import Row, Target
from capsbayes.evidence.verification.section import Results, Section, Values
from capsbayes.physics.stokes.single_layer import SingleLayer
from capsbayes.physics.surface import octasphere

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["section"]

_WORDS = {"translation": "velocity of the sphere drawn by 6 pi mu a U", "pressure": "velocity by a constant pressure"}


def section(refinements: Sequence[int] = (4, 6, 8, 12)) -> Section:
    """Stokes' drag, and the constant normal density, on a few meshes."""
    return Section(
        "single-layer",
        "Single layer",
        "Largest errors at the nodes of a sphere, over its velocity: a uniform traction of total force 6 pi mu a U "
        "moves every point of it with U, and a constant pressure moves nothing. The elements are of third order.",
        {f"n = {n}": partial(_errors, n) for n in refinements},
        partial(_rows, refinements),
        partial(_picture, refinements),
    )


def _errors(refinement: int) -> Values:
    mesh = octasphere(refinement)
    matrix = SingleLayer(mesh, 1.0, mesh.nodes).matrices(mesh.nodes[mesh.wedge], target_nodes=mesh.wedge).velocity
    drawn = (matrix @ np.tile([0.0, 0.0, 1.5], len(mesh.wedge))).reshape(-1, 3)
    pressed = matrix @ mesh.nodes[mesh.wedge].ravel()
    return {
        "translation": float(np.max(np.abs(drawn - [0.0, 0.0, 1.0]))),
        "pressure": float(np.max(np.abs(pressed))),
    }


def _items(refinements: Sequence[int]) -> list[str]:
    return [f"n = {n}" for n in refinements]


def _rows(refinements: Sequence[int], results: Results) -> Iterator[Row]:
    for name, words in _WORDS.items():
        errors = results.across(_items(refinements), name)
        for n, error in zip(refinements, errors, strict=True):
            yield Row(f"{words}: error at n = {n}", float(error), target=Target("at most", 1e-4) if n >= 8 else None)
        yield Row(f"{words}: order", fitted_rate(refinements, errors), target=Target("at least", 2.9))


def _picture(refinements: Sequence[int], results: Results, figure: Figure) -> None:
    axes = figure.subplots()
    for name, words in _WORDS.items():
        axes.loglog(refinements, results.across(_items(refinements), name), "o-", label=words)
    axes.set(xlabel="refinement $n$", ylabel="largest error [U]", xticks=refinements, xticklabels=map(str, refinements))
    axes.minorticks_off()
    axes.legend()
