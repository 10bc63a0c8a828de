"""Pyramid: a model tabulated on finer and finer lattices of (log Ca, a/l), once for many capsules."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
_ROWS = 64  # of a lattice tabulated at once


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
        window = coarse.window
        levels = [_with_borders(_columns(model, coarse.nodes).reshape(*window.shape, -1))]
        levels += [_tabulated(model, replace(window, shape=(n * window.shape[0], n * window.shape[1]))) for n in _FINER]
        return cls(model, window, tuple(levels))

    @property
    def low(self) -> Floats:
        """Corner of all lattices (log Ca, a/l) : (2,) array."""
        return np.array(self.window.low)

    @property
    def step(self) -> Floats:
        """Size of a cell of the first lattice : (2,) array."""
        return np.array(self.window.step)


def _tabulated(model: ForwardModel, window: Window) -> Floats:
    """Return the `COLUMNS` on a lattice, tabulated some rows at once, which takes half the memory."""
    log_ca, size = window.axes
    lattice = np.empty((*window.shape, len(COLUMNS)))
    for first in range(0, len(log_ca), _ROWS):
        rows = log_ca[first : first + _ROWS]
        places = np.repeat(rows, len(size)), np.tile(size, len(rows))
        nodes = Nodes.at(model, *places, np.ones(len(places[0])), None)
        lattice[first : first + _ROWS] = _columns(model, nodes).reshape(len(rows), len(size), -1)
    return _with_borders(lattice)


def _columns(model: ForwardModel, nodes: Nodes) -> Floats:
    """Return the `COLUMNS` at nodes, the distance to the border excepted : (n, c) array."""
    columns = [getattr(nodes.model, name) for name in COLUMNS[:-3]]
    columns += [np.log(nodes.model.stretch_ratio), np.full(len(nodes.size), np.inf), _caveats(model, nodes)]
    return np.stack(columns, axis=1)


def _with_borders(lattice: Floats) -> Floats:
    """Fill in the distance to the border of a lattice."""
    answered = np.isfinite(lattice[..., 0])
    if not answered.all():
        lattice[..., COLUMNS.index("to_border")] = ndimage.distance_transform_cdt(answered, "chessboard")
    return lattice


def _caveats(model: ForwardModel, nodes: Nodes) -> Floats:
    caveats = np.zeros(len(nodes.size))
    theta = {"capillary_number": np.exp(nodes.log_ca), "size_ratio": nodes.size}
    for kind, concerned in model.caveats(theta).items():
        caveats += CAVEATS[kind] * concerned
    return caveats
