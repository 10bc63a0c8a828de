"""Lattices over (log Ca, a/l): the coarse one of a model, kept, and the fine one around a posterior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capsbayes.inference.likelihood import ModelAtPoints
from capsbayes.inference.target import evaluated
from capsbayes.model import ForwardModel

__all__ = ["CoarseTable", "Window"]

Floats = NDArray[np.float64]

_COARSE = (48, 72)


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

    def evaluated(self, model: ForwardModel, error_scale: float) -> tuple[ModelAtPoints, Floats]:
        """Evaluate a model at all nodes, as (i, j) arrays; NaN outside its domain."""
        log_ca, size = self.axes
        ca, sizes = np.repeat(np.exp(log_ca), len(size)), np.tile(size, len(log_ca))
        points, stretch = evaluated(model, ca, sizes, error_scale)
        return points.reshaped(self.shape), stretch.reshape(self.shape)

    def around(self, likely: NDArray[np.bool_], shape: tuple[int, int], bounds: Window) -> Window:
        """Rectangle around the likely cells, within bounds, cut anew.

        One more cell is added on each side, or a quarter of this window where
        the likely cells reach its edge and may go on beyond it.

        Parameters
        ----------
        likely : (i, j) bool array
        shape : tuple of int
            Cells of the new window.
        bounds : Window
            Never left.
        """
        low, high = [], []
        for k in (0, 1):
            index, cells = np.nonzero(likely)[k], self.shape[k]
            before = 1 if index.min() > 0 else max(1, cells // 4)
            after = 1 if index.max() < cells - 1 else max(1, cells // 4)
            low.append(float(max(self.low[k] + self.step[k] * (index.min() - before), bounds.low[k])))
            high.append(float(min(self.low[k] + self.step[k] * (index.max() + 1 + after), bounds.high[k])))
        return Window((low[0], low[1]), (high[0], high[1]), shape)


@dataclass(frozen=True, eq=False)
class CoarseTable:
    """A model on a coarse lattice over its whole domain: where posteriors are looked for first.

    Parameters
    ----------
    window : Window
        Over the domain's bounds.
    model : ModelAtPoints
        Of (i, j) arrays; the covariances of the lengths are widened by the change of the lengths across a cell, so
        that no posterior falls between the nodes.
    """

    window: Window
    model: ModelAtPoints

    @classmethod
    def of(cls, model: ForwardModel) -> CoarseTable:
        """Tabulate a model; done once for many capsules."""
        (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
        window = Window((float(np.log(ca_low)), size_low), (float(np.log(ca_high)), size_high), _COARSE)
        points, _ = window.evaluated(model, 1.0)
        (z_u, z_s), (a_u, a_s) = _changes(points.extent), _changes(points.length)
        wide = replace(
            points,
            zz=points.zz + z_u**2 + z_s**2,
            za=points.za + z_u * a_u + z_s * a_s,
            aa=points.aa + a_u**2 + a_s**2,
        )
        return cls(window, wide)


def _changes(values: Floats) -> tuple[Floats, Floats]:
    """Half of the larger change to a neighbour along each axis, zero where no neighbour has a value."""
    halves = []
    for axis in (0, 1):
        step = np.nan_to_num(np.diff(values, axis=axis))
        none = np.zeros_like(values[:1] if axis == 0 else values[:, :1])
        ahead, behind = np.concatenate([step, none], axis), np.concatenate([none, step], axis)
        halves.append(0.5 * np.where(np.abs(ahead) > np.abs(behind), ahead, behind))
    return halves[0], halves[1]
