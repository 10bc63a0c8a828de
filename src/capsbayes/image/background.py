"""The empty channel behind a capsule: given, the temporal median of a film, or estimated from the picture itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.image.edges.robust import median, quantile
from capsbayes.image.walls import WallLines

_BRIGHT = 85.0  # percentile along the channel that is taken for the empty channel
_ROWS = 64  # of all frames that are held in memory a second time
_CORE = 0.8  # of the half width: part of the channel whose light is averaged along it
_FAINT = 0.01  # of the light: larger differences from a smooth trend are objects
_TILE = 8  # px: side of the squares over which light is averaged, in every second row, where frames are compared
FLICKER, _STEADY = 5.0, 0.01  # largest factor, and smallest change, by which the light of frames is evened out
_FEWEST_TURNS = 4  # frames that tell that two kinds of them take turns
_APART = 0.4  # of the logarithm of a level: a lamp that flickers by a fifth to either side changes it by as much
_KINDS, _BLACK = (0.01, 0.5, 0.99), 4.0  # quantiles of the grey levels of a frame; levels that make no difference
_DARKEST = 0.02  # of the median of the background: below, the ratio to it is meaningless


def temporal_median(
    frames: Sequence[NDArray[Any]], covered: Sequence[Booleans] | None = None, *, share: float = 0.5
) -> Floats:
    """Return the background of a film: at each pixel the median over the frames, which hides passing capsules.

    There are at least three (rows, columns) arrays, spread over more than the passage of a capsule. Where it is known
    which pixels of each frame a capsule covers, these do not count; each pixel is free in some frame. The median is the
    quantile of another share of the frames where that is given.

    Raises
    ------
    InputError
        On fewer than three frames, or frames of different shapes.
    """
    shapes = {np.shape(frame) for frame in frames}
    if len(frames) < 3 or len(shapes) != 1:
        got = f"{len(frames)} of shapes {', '.join(map(str, sorted(shapes)))}" if len(frames) else "none"
        raise InputError("background", "frames", "at least three frames of one shape", got)
    blocks = np.array_split(np.arange(len(frames[0])), max(1, len(frames[0]) // _ROWS))
    levels = []
    for rows in blocks:
        level = np.stack([frame[rows] for frame in frames])
        if covered is not None:  # what is covered comes last
            level = np.where([each[rows] for each in covered], np.inf, level).astype(np.float32)
        levels.append(_quantile(level, share))
    return np.concatenate(levels)


def _quantile(levels: NDArray[Any], share: float) -> Floats:
    """Return a quantile over the first axis, by sorting: for tens of levels in a third of the time of np.median."""
    ordered = np.ascontiguousarray(levels.reshape(len(levels), -1).T)
    ordered.sort(axis=1)
    place = share * (np.count_nonzero(np.isfinite(ordered), axis=1) - 1)
    both = [ordered[np.arange(len(ordered)), rounded(place).astype(int)] for rounded in (np.floor, np.ceil)]
    return np.asarray(np.mean(both, axis=0, dtype=np.float64)).reshape(levels.shape[1:])


def brightness(grey: NDArray[Any], reference: NDArray[Any], share: float = 0.5) -> float:
    """Return the light of a frame over that of another or of the empty channel, both (rows, columns) arrays.

    It is a quantile over tiles: capsules may cover a smaller part of them than its share. A ratio beyond a factor of
    five is no lamp that flickers, and a hundredth makes no difference: 1 is returned.
    """
    size = max(1, grey.shape[1] // _TILE), max(1, grey.shape[0] // _TILE)
    tiles, empty = (
        np.asarray(cv2.resize(each[::2].astype(np.float64), size, interpolation=cv2.INTER_AREA), dtype=np.float64)
        for each in (grey, reference)
    )
    ratio = quantile(transmission(tiles, empty).ravel(), share) if median(empty) > 0.0 else 1.0
    return ratio if 1.0 / FLICKER < ratio < FLICKER and abs(ratio - 1.0) > _STEADY else 1.0


def take_turns(frames: Iterable[NDArray[Any]]) -> bool:
    """Return whether successive frames are of two kinds that take turns, as those of two channels or exposures.

    They differ in their level, or in their darkest or brightest parts compared with it. A capsule that comes and goes
    changes these too, but not in half of the steps from frame to frame.
    """
    dark, level, bright = np.log([np.quantile(frame[::2, ::2], _KINDS) + _BLACK for frame in frames]).T
    for value in (level, dark - level, bright - level):
        ordered = np.sort(value)
        if len(ordered) < _FEWEST_TURNS or (steps := np.diff(ordered)).max() < _APART:
            continue
        turns = np.count_nonzero(np.diff(value > ordered[np.argmax(steps)]))
        if 2 * turns >= len(ordered):
            return True
    return False


def estimate_background(grey: Floats, walls: WallLines, percentile: float = _BRIGHT) -> Floats:
    """Estimate the background from one picture: the bright end of the levels on each line parallel to the walls.

    Grey levels and background are (rows, columns) arrays; the percentile is that of the levels of a line. Light that is
    uneven along the channel stays in the picture.
    """
    bright, across = line_levels(grey, walls, percentile)
    return np.interp(walls.offset((grey.shape[0], grey.shape[1])), across, bright)


def line_levels(grey: Floats, walls: WallLines, percentile: float) -> tuple[Floats, Floats]:
    """Return a percentile of the levels on each line parallel to the walls, and the lines' distances from the axis.

    Lines of which half lies in the picture; distances (n,) in pixels, positive below.
    """
    rows, columns = grey.shape
    turn = cv2.getRotationMatrix2D((walls.centre_column, walls.centre_row), float(np.degrees(walls.tilt)), 1.0)
    level = cv2.warpAffine(
        grey, turn, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
    )
    seen = np.isfinite(level).sum(axis=1) > columns // 2
    levels: Floats = np.nanpercentile(level[seen], percentile, axis=1)
    return levels, (np.flatnonzero(seen) - walls.centre_row).astype(np.float64)


def flatten(light: Floats, walls: WallLines) -> Floats:
    """Divide light (rows, columns) by its smooth trend along the channel, as of vignetting.

    A capsule has edges, and stays.
    """
    rows, columns = light.shape
    within = np.abs(walls.offset((rows, columns))) < _CORE * walls.half_width
    seen = within.any(axis=0)
    level = np.nanmedian(np.where(within, light, np.nan)[:, seen], axis=0)
    design = np.vander(np.linspace(-1.0, 1.0, columns), 3)
    start = np.array([0.0, 0.0, np.percentile(level, _BRIGHT)])

    def residuals(trend: Floats) -> Floats:
        return design[seen] @ trend - level

    fit = least_squares(residuals, start, loss="cauchy", f_scale=_FAINT)
    return np.asarray(light / np.maximum(design @ fit.x, _DARKEST))


def transmission(grey: Floats, background: Floats) -> Floats:
    """Return the light over that of the empty channel : (rows, columns) array."""
    return np.asarray(grey / np.maximum(background, _DARKEST * median(background)))
