"""Where on its outline a capsule may differ from a model: displacements of a region's edge along its normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capsbayes.profile import edge_lengths, vertex_normals

__all__ = ["REGIONS", "region_displacements"]

Floats = NDArray[np.float64]

REGIONS = ("nose", "flanks", "rear rim", "rear on the axis", "top against bottom")
_WIDTH = 0.06  # of the perimeter: standard deviation of a region's bump


def region_displacements(outline: Floats) -> Floats:
    """Bumps of height one at each of the `REGIONS`.

    Parameters
    ----------
    outline : (p, 2) array
        Closed, from the nose, columns (z, y).

    Returns
    -------
    (5, p) array
    """
    lengths = edge_lengths(outline)
    arc = np.concatenate([[0.0], np.cumsum(lengths[:-1])]) / lengths.sum()
    upper = outline[:, 1] > 0.0
    rims = [_farthest_back(outline, side) for side in (upper, ~upper)]
    normal = vertex_normals(outline)
    flank = np.clip(normal[:, 1] * np.sign(outline[:, 1]), 0.0, 1.0) ** 4  # not the inner wall of the dimple
    rim = sum(_bump(arc, arc[place]) for place in rims)
    rear = _bump(arc, _on_axis(outline, arc))
    return np.stack([_bump(arc, 0.0), flank, np.minimum(rim, 1.0), rear, flank * np.sign(normal[:, 1])])


def _bump(arc: Floats, place: float) -> Floats:
    away = np.abs(arc - place)
    away = np.minimum(away, 1.0 - away)
    return np.asarray(np.exp(-0.5 * (away / _WIDTH) ** 2))


def _farthest_back(outline: Floats, side: NDArray[np.bool_]) -> int:
    rows = np.flatnonzero(side)
    return int(rows[np.argmin(outline[rows, 0])])


def _on_axis(outline: Floats, arc: Floats) -> float:
    rear = np.flatnonzero(outline[:, 0] < outline[:, 0].mean())
    return float(arc[rear[np.argmin(np.abs(outline[rear, 1]))]])
