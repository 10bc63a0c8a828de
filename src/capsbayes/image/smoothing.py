"""What a filter or a compression did to a picture after it was taken, seen in its noise.

The noise of a camera differs from pixel to pixel. A filter makes it alike over some pixels; compression too, and leaves
steps between blocks of 8 x 8 pixels. Both flatten the dark line along the edge of a capsule, and the edge is found
further out. Where the empty channel shows either, an edge has an error for it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from capsbayes.arrays import Booleans, Floats
from capsbayes.image.blobs import Blob
from capsbayes.image.walls import WallLines

_LAGS = np.array([1, 2, 3, 4, 6])  # px; over the last, noise is independent in all but the widest filters
_TILE, _FEWEST = 16, 4  # px, and tiles: the median over them is that of the noise, also where some show specks
_ENOUGH = 400  # tiles: of a large picture, every second, third ... is taken
_BLOCK = 8  # px
_STEPS = 4.0  # least ratio of the steps between blocks to those within, both axes multiplied; by chance it is below 1.8
_LOST = 0.3  # least loss of noise that is no chance
_ALL = 2.0  # loss of a picture whose noise is lost altogether, and the largest one of a compressed picture
_FILTERED, _COMPRESSED = 0.10, 0.05  # px: error of an edge over the square of the loss; over the loss
_AROUND, _CLEAR = 12.0, 3.0  # px around a blob, and widths of a wall's line, that are left out


def edge_shift(light: Floats, walls: WallLines, blobs: list[Blob]) -> float:
    """Return the standard error of an edge that follows from smoothing of the picture [px]; 0 where none is seen.

    The light (rows, columns) is over that of the empty channel. All edges share the error, in all pictures of a camera.
    """
    free = _free(light.shape, walls, blobs)
    sums, counts = _tile_sums(light, free, _LAGS, _TILE, max(1, light.size // (_ENOUGH * _TILE**2)))
    whole = counts[:, -1] >= _TILE**2 // 2
    if np.count_nonzero(whole) < _FEWEST:
        return 0.0
    squares = np.median(sums[whole] / np.maximum(counts[whole], 1), axis=0)
    loss = float(np.sum(np.maximum(1.0 - squares[:-1] / squares[-1], 0.0))) if squares[-1] > 0.0 else _ALL
    if loss < _LOST:
        return 0.0
    if _has_blocks(light, free):
        return _COMPRESSED * min(loss, _ALL)
    return _FILTERED * loss**2 if squares[-1] > 0.0 else 0.0


def _free(shape: tuple[int, ...], walls: WallLines, blobs: list[Blob]) -> Booleans:
    """Return which pixels show the liquid alone : (rows, columns) array."""
    free = np.abs(walls.offset((shape[0], shape[1]))) < walls.half_width - _CLEAR * walls.line_width
    for blob in blobs:
        low = np.maximum(np.floor(blob.polygon.min(axis=0) - _AROUND), 0.0).astype(int)
        high = np.ceil(blob.polygon.max(axis=0) + _AROUND).astype(int)
        free[low[1] : high[1], low[0] : high[0]] = False
    return free


@njit(cache=True, nogil=True, error_model="numpy")
def _tile_sums(light, free, lags, size, every):  # type: ignore[no-untyped-def]
    """Return sums of squared second differences at each lag along rows and columns, and their numbers : (tiles, lags).

    A slope of the light has no second difference. Of the tiles, only every so many are summed.
    """
    rows, columns = light.shape
    across = (columns + size - 1) // size
    sums = np.zeros((((rows + size - 1) // size) * across, len(lags)))
    counts = np.zeros(sums.shape, dtype=np.int64)
    for i in range(rows):
        for j in range(columns):
            tile = (i // size) * across + j // size
            if tile % every or not free[i, j]:
                continue
            for n in range(len(lags)):
                k = lags[n]
                if k <= i < rows - k and free[i - k, j] and free[i + k, j]:
                    sums[tile, n] += (light[i, j] - 0.5 * (light[i - k, j] + light[i + k, j])) ** 2
                    counts[tile, n] += 1
                if k <= j < columns - k and free[i, j - k] and free[i, j + k]:
                    sums[tile, n] += (light[i, j] - 0.5 * (light[i, j - k] + light[i, j + k])) ** 2
                    counts[tile, n] += 1
    return sums, counts


def _has_blocks(light: Floats, free: Booleans) -> bool:
    """Return whether the steps from pixel to pixel are larger at every eighth row and column than between."""
    ratio = 1.0
    for axis in (0, 1):
        along, clear = np.moveaxis(light, axis, 0), np.moveaxis(free, axis, 0)
        inside = clear[1:] & clear[:-1]
        steps = np.sum(np.square(np.diff(along, axis=0)), axis=1, where=inside)
        number = np.count_nonzero(inside, axis=1)
        phase = np.arange(len(steps)) % _BLOCK
        mean = np.bincount(phase, steps, _BLOCK) / np.maximum(np.bincount(phase, number, _BLOCK), 1)
        if mean.max() > 0.0:
            ratio *= float(mean.max() / max(np.median(mean), 1e-12))
    return ratio > _STEPS
