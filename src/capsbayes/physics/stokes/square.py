"""Channel of square section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from capsbayes.physics.stokes.channel import Channel, midpoints
from capsbayes.physics.stokes.rectangular import pressure_gradient, series
from capsbayes.physics.surface.symmetry import D4, Symmetry

__all__ = ["SquareChannel"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SquareChannel(Channel):
    """Square section of half width one: a rectangle with twice its symmetry."""

    name: ClassVar[str] = "square"
    symmetry: ClassVar[Symmetry] = D4
    area: ClassVar[float] = 4.0
    pressure_gradient: ClassVar[float] = pressure_gradient(1.0)

    def undisturbed(self, points: Array) -> tuple[Array, Array]:
        """Fourier series; see :meth:`Flow.undisturbed`."""
        return series(points, 1.0)

    def outline(self, spacing: float, outwards: float) -> tuple[Array, Array]:
        """Half of the wall x = 1; see :meth:`Channel.outline`."""
        side = 1.0 + outwards
        across, step = midpoints(side, spacing)
        return np.column_stack([np.full_like(across, side), across]), np.full_like(across, step)

    def filling(self, spacing: float, outwards: float) -> tuple[Array, Array]:
        """A grid on the eighth 0 <= y <= x; see :meth:`Channel.filling`."""
        across, step = midpoints(1.0 + outwards, spacing)
        i, j = np.tril_indices(len(across))
        return np.column_stack([across[i], across[j]]), step**2 * np.where(i == j, 0.5, 1.0)
