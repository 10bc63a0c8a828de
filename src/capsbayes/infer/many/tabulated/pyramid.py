"""Pyramid: a model tabulated on finer and finer lattices of (log Ca, a/l), once for many capsules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from capsbayes.arrays import Floats
from capsbayes.infer.grid.lattice import CoarseTable, Nodes, Window
from capsbayes.model import TWO_SHAPES, UNSURE_SHAPES, WRINKLES, ForwardModel

COLUMNS = (
    "extent",
    "length",
    "velocity_ratio",
    "zz",
    "za",
    "aa",
    "zr",
    "ar",
    "rr",
    "log_stretch_ratio",
    "to_border",
    "caveats",
)
"""Columns at each node; the last two are the number of cells to the next one without an answer, along rows,
columns or diagonals, and the sum of the `CAVEATS` that concern it."""

CAVEATS = {TWO_SHAPES: 1, WRINKLES: 2, UNSURE_SHAPES: 4}

_FINER = (4, 8, 16)  # cells along each side of a cell of the coarse table


@dataclass(frozen=True, eq=False)
class Pyramid:
    """A model on lattices over the box that holds its domain.

    Parameters
    ----------
    model : ForwardModel
        Without a further coordinate.
    window : Window
        Of the first lattice.
    levels : tuple of (i, j, c) arrays
        `COLUMNS` at the centres of the cells, NaN outside the model's domain. The first lattice has its covariances
        widened by the change of the lengths across a cell, so that no posterior falls between its nodes.
    """

    model: ForwardModel
    window: Window
    levels: tuple[Floats, ...]

    @classmethod
    def of(cls, model: ForwardModel) -> Pyramid:
        """Tabulate a model: half a second for the databases that come with the library, and 130 MB."""
        coarse = CoarseTable.of(model)
        levels = [_columns(model, coarse.nodes, coarse.window.shape)]
        for finer in _FINER:
            shape = (finer * coarse.window.shape[0], finer * coarse.window.shape[1])
            window = Window(coarse.window.low, coarse.window.high, shape)
            levels.append(_columns(model, window.nodes(model), shape))
        return cls(model, coarse.window, tuple(levels))

    @property
    def low(self) -> Floats:
        """Corner of all lattices (log Ca, a/l) : (2,) array."""
        return np.array(self.window.low)

    @property
    def step(self) -> Floats:
        """Size of a cell of the first lattice : (2,) array."""
        return np.array(self.window.step)


def _columns(model: ForwardModel, nodes: Nodes, shape: tuple[int, int]) -> Floats:
    answered = np.isfinite(nodes.model.extent.reshape(shape))
    to_border = np.full(answered.size, np.inf)
    if not answered.all():
        to_border = ndimage.distance_transform_cdt(answered, "chessboard").ravel()
    columns = [getattr(nodes.model, name) for name in COLUMNS[:-3]]
    columns += [np.log(nodes.model.stretch_ratio), to_border, _caveats(model, nodes)]
    return np.ascontiguousarray(np.stack(columns, axis=1).reshape(*shape, -1), dtype=np.float64)


def _caveats(model: ForwardModel, nodes: Nodes) -> Floats:
    caveats = np.zeros(len(nodes.size))
    theta = {"capillary_number": np.exp(nodes.log_ca), "size_ratio": nodes.size}
    for kind, concerned in model.caveats(theta).items():
        caveats += CAVEATS[kind] * concerned
    return caveats
