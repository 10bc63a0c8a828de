"""Scaling of the plane (sqrt(Ca), a/l), in which the cases of a database lie about equally far apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats


@dataclass(frozen=True)
class PlaneScaling:
    """Coordinates (sqrt(Ca) / ca_step, (a/l) / size_step).

    >>> PlaneScaling(ca_step=0.01, size_step=0.025).to_plane(0.09, 0.9).round(6)
    array([30., 36.])
    """

    ca_step: float
    size_step: float

    @classmethod
    def of(cls, capillary_number: Floats, size_ratio: Floats) -> PlaneScaling:
        """Derive the steps from columns of equal a/l: medians of 3/4 of the gaps along them and of those between."""
        sizes = np.round(size_ratio, 6)
        columns = np.unique(sizes)
        gaps = [np.diff(np.sort(np.sqrt(capillary_number[sizes == column]))) for column in columns]
        return cls(0.75 * float(np.median(np.concatenate(gaps))), float(np.median(np.diff(columns))))

    def to_plane(self, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Return the coordinates of (Ca, a/l) : (..., 2) array."""
        return np.stack([np.sqrt(capillary_number) / self.ca_step, np.asarray(size_ratio) / self.size_step], axis=-1)

    def from_plane(self, coordinates: Floats) -> Floats:
        """Return (Ca, a/l) of coordinates : (..., 2) array."""
        return np.stack([(coordinates[..., 0] * self.ca_step) ** 2, coordinates[..., 1] * self.size_step], axis=-1)

    def slopes(self, capillary_number: ArrayLike) -> Floats:
        """Return the derivatives of the two coordinates by Ca and by a/l, for the chain rule : (..., 2) array."""
        root = np.sqrt(np.asarray(capillary_number, dtype=np.float64))
        return np.stack([0.5 / (root * self.ca_step), np.full(root.shape, 1.0 / self.size_step)], axis=-1)
