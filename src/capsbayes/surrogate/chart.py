"""Coordinates of the approximation: (log Ca, a/l) in steps over which a steady shape changes about equally."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Chart"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Chart:
    """Plane (log(Ca) / ca_step, (a/l) / size_step).

    Parameters
    ----------
    ca_step : float
        Change of log Ca that counts as one.
    size_step : float
        Change of a/l that counts as one.

    Examples
    --------
    >>> Chart(ca_step=0.2, size_step=0.05).to_plane(1.0, 0.9).round(6)
    array([ 0., 18.])
    """

    ca_step: float = 0.2
    size_step: float = 0.025

    @property
    def steps(self) -> tuple[float, float]:
        """Both steps."""
        return self.ca_step, self.size_step

    def to_plane(self, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Coordinates of (Ca, a/l) : (..., 2) array."""
        return np.stack([np.log(capillary_number) / self.ca_step, np.asarray(size_ratio) / self.size_step], axis=-1)

    def from_plane(self, coordinates: Floats) -> Floats:
        """Columns (Ca, a/l) of coordinates : (..., 2) array."""
        return np.stack([np.exp(coordinates[..., 0] * self.ca_step), coordinates[..., 1] * self.size_step], axis=-1)

    def slopes(self, capillary_number: ArrayLike) -> Floats:
        """Derivatives of the two coordinates by Ca and by a/l, for the chain rule : (..., 2) array."""
        ca = np.asarray(capillary_number, dtype=np.float64)
        return np.stack([1.0 / (ca * self.ca_step), np.full(ca.shape, 1.0 / self.size_step)], axis=-1)
