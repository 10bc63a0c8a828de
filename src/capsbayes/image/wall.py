"""The two walls of the channel in a picture: its centre line, its tilt and its half width in pixels.

A wall shows as a dark line along the picture, and lies in the middle of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from capsbayes.image.edge_models import Model, locate

__all__ = ["Walls", "find_walls"]

Floats = NDArray[np.float64]

_STRIPS = 12
_SLOPES = np.linspace(-0.12, 0.12, 25)
_SMOOTHING = 2.0  # px
_APART = 0.15  # of the picture's height, at least
_SIGNIFICANCE = 8.0  # of a wall's darkness over the scatter of that of all lines
_REACH = 9  # px around a wall that are looked at
_SCATTER = 0.7  # px: strips of a wall may lie that far off the straight line
_MISFIT = 0.03  # of the width of a wall's line: how far the model's middle may be from the wall


@dataclass(frozen=True)
class Walls:
    """Centre line, tilt and half width of the channel.

    Parameters
    ----------
    height : float [px]
        Row at which the centre line crosses the middle column.
    middle : float [px]
        That column.
    tilt : float [rad]
        Angle of the centre line to the rows, from x towards y.
    half_width, half_width_error : float [px]
        l and its standard error.
    line_width : float [px]
        Standard deviation of the dark lines across.
    """

    height: float
    middle: float
    tilt: float
    half_width: float
    half_width_error: float
    line_width: float

    @property
    def along(self) -> Floats:
        """Unit vector (x, y) to the right along the centre line."""
        return np.array([np.cos(self.tilt), np.sin(self.tilt)])

    @property
    def across(self) -> Floats:
        """Unit vector (x, y) downwards across it."""
        return np.array([-np.sin(self.tilt), np.cos(self.tilt)])

    def offset(self, shape: tuple[int, int]) -> Floats:
        """Distance of each pixel of a picture from the centre line, positive below : array of that shape."""
        rows, columns = (np.arange(count, dtype=float) for count in shape)
        return np.asarray((rows[:, None] - self.height) * self.across[1] + (columns - self.middle) * self.across[0])

    def clearance(self, points: Floats) -> Floats:
        """Distance of points (n, 2) [px] from the nearer wall, negative beyond it : (n,) array [px]."""
        off = (points - [self.middle, self.height]) @ self.across
        return np.asarray(self.half_width - np.abs(off))


def find_walls(grey: Floats) -> Walls | None:
    """Find the walls.

    Parameters
    ----------
    grey : (rows, columns) array
        A picture, better of the empty channel than with a capsule in it.

    Returns
    -------
    Walls or None
        None where no two parallel dark lines cross the picture.
    """
    columns = grey.shape[1] // _STRIPS
    strips = grey[:, : columns * _STRIPS].reshape(len(grey), _STRIPS, columns).mean(axis=2).T
    places = columns * (np.arange(_STRIPS) + 0.5) - 0.5
    middle = 0.5 * (grey.shape[1] - 1)
    start = _coarse(strips, places - middle)
    if start is None:
        return None
    upper, lower, slope = start
    starts = np.concatenate([upper + slope * (places - middle), lower + slope * (places - middle)])
    return _fine(strips, places - middle, starts, middle)


def _coarse(strips: Floats, places: Floats) -> tuple[float, float, float] | None:
    """Rows of the two walls in the middle column and their slope, to a pixel or two."""
    ridge = gaussian_filter1d(strips, _SMOOTHING, axis=1, order=2, mode="nearest")
    rows = np.arange(strips.shape[1])
    shift = np.rint(_SLOPES[:, None] * places).astype(int)
    index = rows + shift[:, :, None]
    outside = (index < 0) | (index >= len(rows))
    values = ridge[np.arange(_STRIPS)[:, None], np.clip(index, 0, len(rows) - 1)]
    values[outside] = -np.inf
    # a capsule darkens some strips only: what holds for three in four of them is a wall
    dark = np.partition(values, _STRIPS // 4, axis=1)[:, _STRIPS // 4]
    first = dark.argmax(axis=1)
    others = np.where(np.abs(rows - first[:, None]) > _APART * len(rows), dark, -np.inf)
    second = others.argmax(axis=1)
    each = np.arange(len(_SLOPES))
    best = int(np.argmax(dark[each, first] + others[each, second]))
    weaker = others[best, second[best]]
    scatter = 1.4826 * np.median(np.abs(dark[best][np.isfinite(dark[best])]))
    if not weaker > max(_SIGNIFICANCE * scatter, 1e-3 * np.median(strips)):
        return None
    upper, lower = sorted((int(first[best]), int(second[best])))
    return upper, lower, float(_SLOPES[best])


def _fine(strips: Floats, places: Floats, starts: Floats, middle: float) -> Walls | None:
    """Locate the line in each strip, and lay two parallel lines through what was found."""
    nearest = np.rint(starts).astype(int)
    samples = np.arange(-_REACH, _REACH + 1)
    rows = nearest[:, None] + samples
    within = (rows >= 0) & (rows < strips.shape[1])
    level = np.median(strips)
    profiles = np.concatenate([strips, strips])[np.arange(2 * _STRIPS)[:, None], np.clip(rows, 0, strips.shape[1] - 1)]
    found = locate(
        profiles / level,
        samples.astype(float),
        Model.LINE,
        np.zeros(2 * _STRIPS),
        np.full(2 * _STRIPS, _SMOOTHING),
        within.astype(float),
    )
    height = nearest + found.place
    sound = (found.coefficients[:, 0] < 0.0) & (np.abs(found.place) < 0.6 * _REACH)
    below = np.repeat([0.0, 1.0], _STRIPS)
    design = np.stack([1.0 - below, below, np.concatenate([places, places])], axis=1)
    for _ in range(3):
        if min(sound[:_STRIPS].sum(), sound[_STRIPS:].sum()) < _STRIPS // 3:
            return None
        solution, *_ = np.linalg.lstsq(design[sound], height[sound], rcond=None)
        residual = height - design @ solution
        scatter = max(1.4826 * float(np.median(np.abs(residual[sound]))), 0.005)
        sound &= np.abs(residual) < 4.0 * scatter
    if scatter > _SCATTER:
        return None
    used = design[sound]
    covariance = np.linalg.inv(used.T @ used) * np.sum(residual[sound] ** 2) / max(len(used) - 3, 1)
    tilt = float(np.arctan(solution[2]))
    half = 0.5 * np.cos(tilt)
    width = float(np.median(found.width[sound]))
    variance = half**2 * (covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]) + 0.5 * (_MISFIT * width) ** 2
    return Walls(
        height=float(0.5 * (solution[0] + solution[1])),
        middle=middle,
        tilt=tilt,
        half_width=float(half * (solution[1] - solution[0])),
        half_width_error=float(np.sqrt(variance)),
        line_width=width,
    )
