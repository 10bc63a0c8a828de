"""Light that falls off towards the borders, as by a lens or a lamp off the middle: taken out where it is strong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsbayes.image.files.picture import Picture
from capsbayes.image.walls import WallLines

_CORE = 0.6  # of the half width: part of the channel whose light is followed along it
_STRONG = 0.18  # fall of the light along the channel up to which lengths and walls are right as they are
_BEYOND, _FEWEST = 3.0, 8  # of the width of a wall's line, beyond which light is followed; rows that this needs
_DARK, _LITTLE = 0.02, 0.01  # below the trend by more than this share of it, and how little such a column then counts
_FREE = 0.4  # of the columns, that need to follow the trend
_ROUNDS = 30


def evened(pictures: tuple[Picture, ...], walls: WallLines) -> tuple[Picture, ...] | None:
    """Return pictures of one view over the light along the channel in the last; None where that hardly changes.

    The light is 1 + b x + c (x^2 + y^2) with a c that is not positive, as a lens loses it alike in all directions. It
    follows from what lies beyond the walls, or from the columns of the channel that a dark capsule leaves free.
    """
    grey = pictures[-1].grey
    rows, columns = grey.shape
    away = np.abs(walls.offset((rows, columns)))
    strip = away > walls.half_width + _BEYOND * walls.line_width
    if strip.sum(axis=0).min() < _FEWEST:
        strip = away < _CORE * walls.half_width
    if not strip.any(axis=0).all():
        return None
    level = np.nanmedian(np.where(strip, grey, np.nan), axis=0)
    x = np.arange(columns) - 0.5 * (columns - 1)
    weight, powers = np.ones(columns), 3
    for _ in range(_ROUNDS):  # least squares that leave dark columns out
        design = np.stack([x**power for power in range(powers)], axis=1) * weight[:, None]
        fit = np.append(np.linalg.lstsq(design, level * weight, rcond=None)[0], 0.0)[:3]
        powers = 3 if fit[2] < 0.0 else 2
        trend = fit[0] + fit[1] * x + min(fit[2], 0.0) * x**2
        weight = np.where(level < (1.0 - _DARK) * trend, _LITTLE, 1.0)
    if trend.min() <= 0.0 or 1.0 - trend.min() / trend.max() < _STRONG or np.mean(weight) < _FREE:
        return None
    y = np.arange(rows)[:, None] - 0.5 * (rows - 1)
    light = np.maximum(1.0 + (fit[1] * x + min(fit[2], 0.0) * (x**2 + y**2)) / fit[0], 0.1)
    return tuple(replace(picture, grey=picture.grey / light) for picture in pictures)
