"""Whether capsules are darker or brighter than the liquid; bright ones are measured in the mirrored picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capsbayes.arrays import Floats
from capsbayes.image.background import estimate_background
from capsbayes.image.edges.robust import quantile
from capsbayes.image.files.picture import Picture
from capsbayes.image.walls import WallLines, find_walls

CONTRASTS = ("dark", "bright")
_ENDS = 0.001, 0.999  # quantiles of what differs from the empty channel
_BRIGHTER = 2.0  # of the largest darkening: a dark capsule may gather light in its middle
_EVERY = 2  # px: neighbours in a smoothed picture are alike, and percentiles of many pixels take time
_CLEAR = 2.0  # of the width of a wall's line: nearer to it, the line itself differs


def mirror_level(empty: Floats, frames: Sequence[NDArray[Any]]) -> float:
    """Return the grey level from which those of a bright picture are subtracted.

    The empty channel becomes as bright as the brightest place of the frames, and that as dark as the channel was. All
    are (rows, columns) arrays. A single bright pixel, as a faulty one, does not count.
    """
    brightest = max(float(cv2.medianBlur(frame.astype(np.float32), 3).max()) for frame in (empty, *frames))
    return brightest + float(np.median(empty))


def is_brighter(frames: Sequence[NDArray[Any]], empty: Floats, walls: WallLines) -> bool:
    """Return True if what differs most from the empty channel between the walls is brighter than it."""
    some = slice(None, None, _EVERY)
    rows = walls.rows_around((empty.shape[0], empty.shape[1]))
    empty = empty[rows]
    offset = walls.moved(0, -rows.start).offset((empty.shape[0], empty.shape[1]))
    between = np.abs(offset[some, some]) < walls.half_width - _CLEAR * walls.line_width
    darkening = brightening = 0.0
    for frame in frames:
        change = cv2.GaussianBlur(np.subtract(frame[rows], empty, dtype=np.float32), (0, 0), 1.0)[some, some][between]
        least, most = (quantile(change, share) for share in _ENDS) if change.size else (0.0, 0.0)
        darkening, brightening = max(darkening, -least), max(brightening, most)
    return brightening > _BRIGHTER * darkening


def runs_upright(picture: NDArray[Any], contrast: str | None) -> bool:
    """Return True if walls are found up and down a picture (rows, columns), and none along its rows."""
    ways = (picture, np.ascontiguousarray(picture.T))
    along, upright = (Contrast.of([way], None, None, contrast).walls for way in ways)
    return along is None and upright is not None


@dataclass(frozen=True)
class Contrast:
    """How pictures of one view are made such that capsules are dark, and the walls in them.

    Parameters
    ----------
    mirror : float, optional
        Grey level from which those of the pictures are subtracted; None where capsules are dark already.
    walls : WallLines, optional
        As stated or found; None where none were found.
    """

    mirror: float | None
    walls: WallLines | None

    @classmethod
    def of(
        cls, frames: Sequence[NDArray[Any]], empty: Floats | None, stated: WallLines | None, contrast: str | None
    ) -> Contrast:
        """Find out whether capsules and walls are darker or brighter than the liquid.

        The walls tell it where they are found in one of the two ways only, else the capsules do.

        Parameters
        ----------
        frames : sequence of (rows, columns) array
            Pictures of one view, in grey levels.
        empty : (rows, columns) array, optional
            The empty channel; by default the median of the first picture on each line parallel to the walls.
        stated : WallLines, optional
            Walls that are stated; by default they are sought.
        contrast : str, optional
            One of `CONTRASTS`, where it is stated.
        """
        base = frames[0] if empty is None else empty
        walls = stated or (None if contrast == "bright" else find_walls(base))
        if contrast == "dark":
            return cls(None, walls)
        if contrast is None and walls is not None:
            ground = estimate_background(base, walls, percentile=50.0) if empty is None else empty
            if not is_brighter(frames, ground, walls):
                return cls(None, walls)
        level = mirror_level(base, frames)
        bright_walls = stated or find_walls(level - base)
        if contrast is None and bright_walls is None:
            return cls(None, walls)
        return cls(level, bright_walls)

    def darkened(self, grey: NDArray[Any]) -> NDArray[Any]:
        """Return grey levels as they are analysed."""
        return grey if self.mirror is None else self.mirror - grey

    def shown(self, picture: Picture) -> Picture:
        """Return a picture as it is analysed."""
        return picture if self.mirror is None else picture.mirrored(self.mirror)
