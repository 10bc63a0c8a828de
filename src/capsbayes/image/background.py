"""The empty channel behind a capsule: given, the temporal median of a film, or guessed from the picture itself."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.image.wall import Walls

__all__ = ["along_the_channel", "temporal_median", "transmission"]

Floats = NDArray[np.float64]

_BRIGHT = 85.0  # percentile along the channel that the empty channel is taken for
_ROWS = 64  # of all frames that are held in memory a second time
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
    return np.concatenate([np.median(np.stack([frame[some] for frame in frames]), axis=0) for some in rows])


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


def transmission(grey: Floats, background: Floats) -> Floats:
    """Share of the light of the empty channel that is left : (rows, columns) array."""
    return np.asarray(grey / np.maximum(background, _DARKEST * np.median(background)))
