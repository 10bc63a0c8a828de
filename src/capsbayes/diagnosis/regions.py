"""Displacements of regions of the outline that all capsules of a session have in common."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from capsbayes.arrays import Booleans, Floats
from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.whitening import OfOutline, Whitening
from capsbayes.profile import edge_lengths, vertex_normals

REGIONS = ("nose", "flanks", "rear rim", "rear on the axis", "top against bottom")
_WIDTH = 0.06  # of the perimeter: standard deviation of a region's bump


def region_displacements(outline: Floats) -> Floats:
    """Return bumps of height one at each of the `REGIONS` of a closed outline (p, 2) from the nose : (5, p) array."""
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


def _farthest_back(outline: Floats, side: Booleans) -> int:
    rows = np.flatnonzero(side)
    return int(rows[np.argmin(outline[rows, 0])])


def _on_axis(outline: Floats, arc: Floats) -> float:
    rear = np.flatnonzero(outline[:, 0] < outline[:, 0].mean())
    return float(arc[rear[np.argmin(np.abs(outline[rear, 1]))]])


class Displaced(NamedTuple):
    """Whitened residuals due to displacements of the regions by l, once log Ca and a/l have absorbed what they can."""

    row: int  # of the capsule
    seen: OfOutline  # its outline
    pattern: Floats  # (5, m)


def displaced_regions(white: Whitening, fits: Fits) -> list[Displaced]:
    """Return the residuals due to displaced regions, for capsules that have an outline and a best shape."""
    found = []
    for row in np.flatnonzero(fits.settled):
        whitener = white.each[row]
        if isinstance(whitener, OfOutline):
            likelihood = whitener.likelihood
            whole = likelihood.whitened_displacement(region_displacements(likelihood.pilot))
            basis = np.linalg.qr(fits.slopes[row])[0]
            found.append(Displaced(int(row), whitener, whole - (whole @ basis) @ basis.T))
    return found
