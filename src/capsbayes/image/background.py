"""The empty channel behind a capsule: given, the temporal median of a film, or guessed from the picture itself."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from capsbayes.errors import InputError
from capsbayes.image.wall import Walls

__all__ = ["along_the_channel", "evened", "temporal_median", "transmission"]

Floats = NDArray[np.float64]

_BRIGHT = 85.0  # percentile along the channel that the empty channel is taken for
_ROWS = 64  # of all frames that are held in memory a second time
_MIDST = 0.8  # of the half width: where the light along the channel is looked at
_FAINT = 0.01  # of the light: what differs by more from a smooth trend is none of it
_DARKEST = 0.02  # of the median of the background: below, the ratio to it means nothing


def temporal_median(frames: Sequence[Floats]) -> Floats:
    """Background of a film: at each pixel the median over the frames, which a passing capsule does not move.

    Parameters
    ----------
    frames : sequence of (rows, columns) arrays
        At least three, spread over more than the passage of a capsule.

    Returns
    -------
    (rows, columns) array

    Raises
    ------
    InputError
        On fewer than three frames, or frames of different shapes.
    """
    shapes = {np.shape(frame) for frame in frames}
    if len(frames) < 3 or len(shapes) != 1:
        got = f"{len(frames)} of shapes {', '.join(map(str, sorted(shapes)))}" if len(frames) else "none"
        raise InputError("background", "frames", "at least three frames of one shape", got)
    rows = np.array_split(np.arange(len(frames[0])), max(1, len(frames[0]) // _ROWS))
    return np.concatenate([_median(np.stack([frame[some] for frame in frames])) for some in rows])


def _median(levels: Floats) -> Floats:
    """Over the first axis, by sorting: for tens of levels in a third of the time of numpy's median."""
    ordered = np.ascontiguousarray(levels.reshape(len(levels), -1).T)
    ordered.sort(axis=1)
    middle = len(levels) // 2
    both = ordered[:, [middle if len(levels) % 2 else middle - 1, middle]]
    return np.asarray(both.mean(axis=1, dtype=np.float64).reshape(levels.shape[1:]))


def along_the_channel(grey: Floats, walls: Walls) -> Floats:
    """Background of one picture alone: the bright end of what lies on each line parallel to the walls.

    It leaves light that is uneven along the channel in the picture.

    Parameters
    ----------
    grey : (rows, columns) array
        The picture.
    walls : Walls
        Its walls.

    Returns
    -------
    (rows, columns) array
    """
    rows, columns = grey.shape
    turn = cv2.getRotationMatrix2D((walls.middle, walls.height), float(np.degrees(walls.tilt)), 1.0)
    level = cv2.warpAffine(
        grey, turn, (columns, rows), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
    )
    seen = np.isfinite(level).sum(axis=1) > columns // 2
    bright = np.nanpercentile(level[seen], _BRIGHT, axis=1)
    across = np.flatnonzero(seen) - walls.height
    return np.interp(walls.offset((rows, columns)), across, bright)


def evened(light: Floats, walls: Walls) -> Floats:
    """Light without what changes smoothly along the channel, as vignetting does: a capsule has edges, and stays.

    Parameters
    ----------
    light : (rows, columns) array
        Share of the light of the empty channel.
    walls : Walls
        Its walls.

    Returns
    -------
    (rows, columns) array
    """
    within = np.abs(walls.offset((light.shape[0], light.shape[1]))) < _MIDST * walls.half_width
    seen = within.any(axis=0)
    level = np.nanmedian(np.where(within, light, np.nan)[:, seen], axis=0)
    design = np.vander(np.linspace(-1.0, 1.0, light.shape[1]), 3)
    start = np.array([0.0, 0.0, np.percentile(level, _BRIGHT)])

    def off(trend: Floats) -> Floats:
        return design[seen] @ trend - level

    fit = least_squares(off, start, loss="cauchy", f_scale=_FAINT)
    return np.asarray(light / np.maximum(design @ fit.x, _DARKEST))


def transmission(grey: Floats, background: Floats) -> Floats:
    """Share of the light of the empty channel that is left : (rows, columns) array."""
    return np.asarray(grey / np.maximum(background, _DARKEST * np.median(background)))
