"""Where a database's shape need not be that of every capsule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from capsbayes.database import LOST_FROM_REST, SNAP_THROUGH, Database
from capsbayes.model import TWO_SHAPES, WRINKLES
from capsbayes.surrogate.domain import Region
from capsbayes.surrogate.scaling import PlaneScaling

__all__ = ["Caveats"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Caveats:
    """What the cases leave open.

    Parameters
    ----------
    two_shapes : Region or None
        Where it is not known which shape is reached from rest, or another than that is stable too.
    scaling : PlaneScaling
        In whose plane the nearest case is sought.
    cases : (c, 2) array
        Cases in that plane.
    wrinkled : (c,) bool array
        Whether the axisymmetric shape of each is unstable to wrinkles.
    """

    two_shapes: Region | None
    scaling: PlaneScaling
    cases: Floats
    wrinkled: NDArray[np.bool_]

    @classmethod
    def of(cls, cases: Database, scaling: PlaneScaling) -> Caveats:
        """Those of converged cases."""
        places = scaling.to_plane(cases["capillary_number"], cases["size_ratio"])
        return cls(_two_shapes(cases), scaling, places, np.asarray(cases["wrinkling_rate"] > 0.0))

    def __call__(self, capillary_number: Floats, size_ratio: Floats) -> dict[str, NDArray[np.bool_]]:
        """By kind of doubt, whether it concerns each point : (n,) arrays."""
        found = {}
        if self.two_shapes is not None:
            found[TWO_SHAPES] = self.two_shapes.contains(capillary_number, size_ratio)
        if self.wrinkled.any():
            places = self.scaling.to_plane(capillary_number, size_ratio)
            known: NDArray[np.bool_] = np.asarray(np.isfinite(places).all(axis=1))
            nearest = np.asarray(KDTree(self.cases).query(np.where(known[:, None], places, 0.0))[1])
            found[WRINKLES] = np.logical_and(known, self.wrinkled[nearest])
        return found


def _two_shapes(database: Database) -> Region | None:
    """The region below the highest snap-through of a column and its neighbours.

    The membrane buckles sooner or later by chance. In a column where the branch from rest was lost before any
    snap-through, the region reaches to the highest of all columns.
    """
    size, ca, kind = (database[f"border_{name}"] for name in ("size_ratio", "capillary_number", "kind"))
    marked = (kind == SNAP_THROUGH) | (kind == LOST_FROM_REST)
    if np.count_nonzero(marked) < 2:
        return None
    order = np.flatnonzero(marked)[np.argsort(size[marked])]
    highest = np.where(kind[order] == LOST_FROM_REST, ca[marked].max(), ca[order])
    highest = np.max([highest, np.append(highest[1:], 0.0), np.append(0.0, highest[:-1])], axis=0)
    lowest = np.full(len(order), database["capillary_number"].min())
    return Region(size[order], lowest, highest, np.zeros(len(order), dtype=np.bool_))
