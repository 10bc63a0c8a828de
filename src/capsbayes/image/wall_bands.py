"""Whether walls that were stated lie on dark lines that the picture shows.

A wall may be stated off the line that shows it: lengths over l are then wrong by as much as l is, and nothing else
shows it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from capsbayes.arrays import Floats
from capsbayes.image.background import line_levels
from capsbayes.image.edges.robust import robust_spread
from capsbayes.image.walls import WallLines

_SMOOTHING = 2.0  # px
_REACH = 20.0  # px to either side of a wall that are searched
_SIGNIFICANCE = 8.0  # of a line's darkness over the spread of that of all rows
_SURE = 3.0  # standard errors of a wall, or px if these are more, up to which it lies on a line
_PERCENTILE = 75.0  # of the levels along a line: a capsule darkens less than three quarters of it


def compared_with_bands(walls: WallLines, grey: Floats) -> WallLines:
    """Return walls with their distances from the dark lines of a picture (rows, columns), see `WallLines.off_band`."""
    levels, across = line_levels(grey, walls, _PERCENTILE)
    ridge = gaussian_filter1d(levels, _SMOOTHING, order=2, mode="nearest")
    least = max(_SIGNIFICANCE * robust_spread(ridge), 1e-3 * float(np.median(levels)))
    before, inner, after = ridge[:-2], ridge[1:-1], ridge[2:]
    dark = (inner > before) & (inner >= after) & (inner > least)
    vertex = 0.5 * (after - before)[dark] / (2.0 * inner - before - after)[dark]
    lines = across[1:-1][dark] + vertex
    upper, lower = (_off(side * lines - walls.half_width, walls) for side in (-1.0, 1.0))
    return replace(walls, off_band=(upper, lower))


def _off(outwards: Floats, walls: WallLines) -> float:
    """Return how far a wall lies outside the nearest line, by the lines' distances from it outwards; 0 if on it."""
    near = outwards[np.abs(outwards) < _REACH]
    if not len(near):
        return 0.0
    nearest = float(near[np.argmin(np.abs(near))])
    error = np.sqrt(2.0) * walls.half_width_error  # of either wall
    return -nearest if abs(nearest) > _SURE * max(error, 1.0) else 0.0
