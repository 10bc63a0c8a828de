"""Lattices over (log Ca, a/l): the coarse one of a model, which is kept, and the fine one around a posterior.

A window is a rectangle of that plane, cut into cells; the model is evaluated at nodes, the centres of the cells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.model import ForwardModel

COARSE_DROP = 12.0  # of the log density, within which cells of a coarse table carry it
_COARSE = (48, 72)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes of the (log Ca, a/l) plane, each the centre of a piece of it, and the predictions of a model there.

    Parameters
    ----------
    log_ca, size : (n,) arrays
        Centres of the pieces.
    side : (n,) array
        Sides of a piece over those of a cell.
    model : ModelAtPoints
        Of (n,) arrays, NaN outside the model's domain.
    cell : (n,) array
        Number of the cell of a window, row by row of log Ca, in which each lies; empty without a window.
    """

    log_ca: Floats
    size: Floats
    side: Floats
    model: ModelAtPoints
    cell: Integers

    @classmethod
    def at(
        cls,
        forward: ForwardModel,
        log_ca: Floats,
        size: Floats,
        side: Floats,
        cell: Integers,
        density: PosteriorDensity | None,
    ) -> Nodes:
        """Evaluate a model at centres of pieces: all that a posterior density reads, by default the lengths."""
        ca = np.exp(log_ca)
        if density is not None:
            return cls(log_ca, size, side, density.evaluated(forward, ca, size), cell)
        return cls(log_ca, size, side, ModelAtPoints.of(forward({"capillary_number": ca, "size_ratio": size})), cell)

    def taken(self, index: NDArray[np.intp] | Booleans) -> Nodes:
        """Return some of the nodes."""
        cell = self.cell[index] if len(self.cell) else self.cell
        return Nodes(self.log_ca[index], self.size[index], self.side[index], self.model.taken(index), cell)

    def joined(self, other: Nodes) -> Nodes:
        """Return these nodes followed by others."""
        return Nodes(
            np.concatenate([self.log_ca, other.log_ca]),
            np.concatenate([self.size, other.size]),
            np.concatenate([self.side, other.side]),
            self.model.joined(other.model),
            np.concatenate([self.cell, other.cell]),
        )


@dataclass(frozen=True)
class Window:
    """A rectangle of (log Ca, a/l) cut into cells, with a node at the centre of each.

    Parameters
    ----------
    low, high : tuple of float
        Corners (log Ca, a/l).
    shape : tuple of int
        Number of cells along each.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    shape: tuple[int, int]

    @property
    def step(self) -> tuple[float, float]:
        """Size of a cell."""
        return (
            (self.high[0] - self.low[0]) / self.shape[0],
            (self.high[1] - self.low[1]) / self.shape[1],
        )

    @property
    def axes(self) -> tuple[Floats, Floats]:
        """Centres of the cells along log Ca and along a/l."""
        steps = self.step
        return tuple(self.low[k] + steps[k] * (np.arange(self.shape[k]) + 0.5) for k in (0, 1))  # type: ignore[return-value]

    def nodes(
        self, forward: ForwardModel, density: PosteriorDensity | None = None, visited: Booleans | None = None
    ) -> Nodes:
        """Return one node for each cell, or for each of those visited (i, j), row by row of log Ca."""
        log_ca, size = self.axes
        cell = np.arange(len(log_ca) * len(size)) if visited is None else np.flatnonzero(visited)
        row, column = np.divmod(cell, len(size))
        return Nodes.at(forward, log_ca[row], size[column], np.ones(len(cell)), cell, density)

    def split(
        self, nodes: Nodes, cut: Booleans, parts: int, forward: ForwardModel, density: PosteriorDensity | None = None
    ) -> Nodes:
        """Replace the nodes of some cells by those of smaller pieces inside the model's domain.

        Parameters
        ----------
        nodes : Nodes
            One for each cell that is visited.
        cut : (i, j) bool array
            Cells to split.
        parts : int
            Pieces along each side of a cell.
        """
        chosen = cut.ravel()[nodes.cell]
        offsets = (np.arange(parts) + 0.5) / parts - 0.5
        log_ca = nodes.log_ca[chosen, None, None] + self.step[0] * offsets[:, None]
        size = nodes.size[chosen, None, None] + self.step[1] * offsets
        log_ca, size = (grid.ravel() for grid in np.broadcast_arrays(log_ca, size))
        sides, cell = np.full(log_ca.size, 1.0 / parts), np.repeat(nodes.cell[chosen], parts**2)
        pieces = Nodes.at(forward, log_ca, size, sides, cell, density)
        return nodes.taken(~chosen).joined(pieces.taken(np.isfinite(pieces.model.extent)))

    def around(self, likely: Booleans, shape: tuple[int, int], bounds: Window) -> Window:
        """Return a window around the likely cells, within bounds, cut anew.

        One more cell is added on each side, or a quarter of this window where
        the likely cells reach its edge and may go on beyond it.

        Parameters
        ----------
        likely : (i, j) bool array
        shape : tuple of int
            Cells of the new window.
        bounds : Window
            Window that contains the result.
        """
        low, high = [], []
        for k in (0, 1):
            cells = self.shape[k]
            first, last = np.flatnonzero(likely.any(axis=1 - k))[[0, -1]].tolist()
            before = 1 if first > 0 else max(1, cells // 4)
            after = 1 if last < cells - 1 else max(1, cells // 4)
            low.append(float(max(self.low[k] + self.step[k] * (first - before), bounds.low[k])))
            high.append(float(min(self.low[k] + self.step[k] * (last + 1 + after), bounds.high[k])))
        return Window((low[0], low[1]), (high[0], high[1]), shape)

    def open_ends(self, bounds: Window, axis: int) -> tuple[bool, bool]:
        """Return whether the low and the high end of an axis lie inside `bounds`."""
        return self.low[axis] > bounds.low[axis], self.high[axis] < bounds.high[axis]

    def wider(self, bounds: Window, shape: tuple[int, int]) -> Window:
        """Return a window three times as wide along both axes, within bounds, cut anew."""
        width = [self.high[k] - self.low[k] for k in (0, 1)]
        low = [max(self.low[k] - width[k], bounds.low[k]) for k in (0, 1)]
        high = [min(self.high[k] + width[k], bounds.high[k]) for k in (0, 1)]
        return Window((low[0], low[1]), (high[0], high[1]), shape)


@dataclass(frozen=True, eq=False)
class CoarseTable:
    """A model on a coarse lattice, by default over its whole domain: there the search for a posterior begins.

    Parameters
    ----------
    window : Window
    nodes : Nodes
        One for each cell; the covariances of the lengths are widened by the change of the lengths across a cell, so
        that no posterior falls between the nodes.
    """

    window: Window
    nodes: Nodes

    @classmethod
    def of(cls, forward: ForwardModel) -> CoarseTable:
        """Tabulate a model, once for many capsules."""
        (ca_low, ca_high), (size_low, size_high) = forward.domain.bounds
        return cls.on(Window((float(np.log(ca_low)), size_low), (float(np.log(ca_high)), size_high), _COARSE), forward)

    def carried(self, log_density: Floats, drop: float = COARSE_DROP) -> Booleans:
        """Return the cells that carry a log density (n,) : (i, j) array."""
        return (log_density > np.nanmax(log_density) - drop).reshape(self.window.shape)

    @classmethod
    def on(cls, window: Window, forward: ForwardModel) -> CoarseTable:
        """Tabulate a model on a window."""
        return cls.widened(window, window.nodes(forward))

    @classmethod
    def widened(cls, window: Window, nodes: Nodes) -> CoarseTable:
        """Return the table of nodes that are known, one for each cell of a window."""
        model = nodes.model
        (z_u, z_s), (a_u, a_s) = (_changes(lengths.reshape(window.shape)) for lengths in (model.extent, model.length))
        wide = model._replace(
            zz=model.zz + (z_u**2 + z_s**2).ravel(),
            za=model.za + (z_u * a_u + z_s * a_s).ravel(),
            aa=model.aa + (a_u**2 + a_s**2).ravel(),
        )
        return cls(window, replace(nodes, model=wide))


def _changes(values: Floats) -> tuple[Floats, Floats]:
    """Return half of the larger change to a neighbour along each axis, zero where no neighbour has a value."""
    halves = []
    for axis in (0, 1):
        step = np.nan_to_num(np.diff(values, axis=axis))
        none = np.zeros_like(values[:1] if axis == 0 else values[:, :1])
        ahead, behind = np.concatenate([step, none], axis), np.concatenate([none, step], axis)
        halves.append(0.5 * np.where(np.abs(ahead) > np.abs(behind), ahead, behind))
    return halves[0], halves[1]
