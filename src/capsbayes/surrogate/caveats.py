"""Points of the plane where the shape of a database need not be that of every capsule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import LOST_FROM_REST, SNAP_THROUGH, Database
from capsbayes.model import TWO_SHAPES, UNSURE, UNSURE_SHAPES, WRINKLES
from capsbayes.prediction import Prediction
from capsbayes.surrogate.domain import Region
from capsbayes.surrogate.scaling import PlaneScaling


@dataclass(frozen=True, eq=False)
class Caveats:
    """Caveats that the cases of a database imply."""

    two_shapes: Region | None  # where the shape reached from rest is unknown, or another is stable too
    scaling: PlaneScaling  # of the plane in which the nearest case is sought
    cases: Floats  # (c, 2): positions in that plane
    wrinkled: Booleans  # (c,): whether the axisymmetric shape is unstable to wrinkles

    @classmethod
    def of(cls, cases: Database, scaling: PlaneScaling) -> Caveats:
        """Derive the caveats from converged cases."""
        places = scaling.to_plane(cases["capillary_number"], cases["size_ratio"])
        return cls(_two_shapes(cases), scaling, places, np.asarray(cases["wrinkling_rate"] > 0.0))

    def __call__(self, capillary_number: Floats, size_ratio: Floats) -> dict[str, Booleans]:
        """Return by kind whether a caveat concerns each point : (n,) arrays."""
        caveats = {}
        if self.two_shapes is not None:
            caveats[TWO_SHAPES] = self.two_shapes.contains(capillary_number, size_ratio)
        if self.wrinkled.any():
            places = self.scaling.to_plane(capillary_number, size_ratio)
            known: Booleans = np.asarray(np.isfinite(places).all(axis=1))
            nearest = np.asarray(KDTree(self.cases).query(np.where(known[:, None], places, 0.0))[1])
            caveats[WRINKLES] = np.logical_and(known, self.wrinkled[nearest])
        return caveats


def with_unsure_shapes(caveats: dict[str, Booleans], predicted: Prediction) -> dict[str, Booleans]:
    """Add the caveat of points with a large stated error, if there are any."""
    lengths = predicted.values[:, :2]
    variances = np.diagonal(predicted.covariance, axis1=1, axis2=2)[:, :2]
    unsure: Booleans = np.asarray((variances > (UNSURE * lengths) ** 2).any(axis=1))
    return caveats | {UNSURE_SHAPES: unsure} if unsure.any() else caveats


def _two_shapes(database: Database) -> Region | None:
    """Return the region below the highest snap-through of a column and its neighbours, None without two columns."""
    # At which Ca the membrane buckles varies at random. In a column where the branch from rest was lost before any
    # snap-through, the region reaches up to the highest snap-through of all columns.
    size, ca, kind = (database[f"border_{name}"] for name in ("size_ratio", "capillary_number", "kind"))
    marked = (kind == SNAP_THROUGH) | (kind == LOST_FROM_REST)
    if np.count_nonzero(marked) < 2:
        return None
    order = np.flatnonzero(marked)[np.argsort(size[marked])]
    highest = np.where(kind[order] == LOST_FROM_REST, ca[marked].max(), ca[order])
    highest = np.max([highest, np.append(highest[1:], 0.0), np.append(0.0, highest[:-1])], axis=0)
    lowest = np.full(len(order), database["capillary_number"].min())
    return Region(size[order], lowest, highest, np.zeros(len(order), dtype=np.bool_))
