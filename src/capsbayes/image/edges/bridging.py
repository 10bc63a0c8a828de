"""Stretches of an outline that a person erased: which points they hold, and the smooth curve that bridges them."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Booleans, Floats, Integers

_ERROR = 0.25, 1.0  # of a bridge: px, and of its height over the chord, as a corner may have been erased
_BESIDE = 14  # points to either side that tell the direction of the curve at an end
_SHORTEST, _FEWEST = 6, 42  # points of a stretch that is left, and of all together


def within(points: Floats, boxes: Floats) -> Booleans:
    """Return which points (n, 2) lie in one of boxes (k, 4) of left, upper, right and lower limit : (n,) array."""
    inside = np.all((points[:, None] >= boxes[:, :2]) & (points[:, None] <= boxes[:, 2:]), axis=2)
    return np.asarray(np.any(inside, axis=1))


def bridged(curve: Floats, erased: Booleans) -> tuple[Floats, Booleans] | None:
    """Return a closed curve (n, 2) with its erased stretches bridged, and which of its points are a bridge.

    A bridge is a cubic with the directions of the curve at its ends, as long as an arc of a circle would be. None where
    too little is left.
    """
    if not erased.any():
        return curve, erased
    left = [run for run in runs(erased) if not erased[run[0]] and len(run) >= _SHORTEST]
    if sum(map(len, left)) < _FEWEST:
        return None
    pieces = []
    for run, following in zip(left, [*left[1:], left[0]], strict=True):
        bridge = _bridge(*_end(curve[run[::-1]]), *_end(curve[following]))
        pieces += [(curve[run], False), (bridge, True)]
    points = np.concatenate([piece for piece, _ in pieces])
    return points, np.concatenate([np.full(len(piece), flag) for piece, flag in pieces])


def bridge_errors(points: Floats, erased: Booleans) -> Floats:
    """Return the standard error [px] of each point (n, 2) of a bridge by the height of its bridge; zero elsewhere."""
    errors = np.zeros(len(points))
    least, share = _ERROR
    for run in runs(erased):
        if erased[run[0]]:
            chord, away = points[run[-1]] - points[run[0]], points[run] - points[run[0]]
            height = np.abs(chord[0] * away[:, 1] - chord[1] * away[:, 0]).max() / max(np.hypot(*chord), 1.0)
            errors[run] = np.hypot(least, share * height)
    return errors


def runs(erased: Booleans) -> list[Integers]:
    """Return the places of consecutive points of a closed curve that are alike, each of which may pass the last one."""
    changes = np.flatnonzero(erased != np.roll(erased, 1))
    if len(changes) == 0:
        return [np.arange(len(erased))]
    order = np.roll(np.arange(len(erased)), -changes[0])
    return list(np.split(order, changes[1:] - changes[0]))


def _end(points: Floats) -> tuple[Floats, Floats]:
    """Return the first of points of a curve, smoothed, and the unit vector from there on along the curve."""
    beside = points[:_BESIDE]
    t = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(beside, axis=0).T))])
    _, slope, place = np.polyfit(t, beside, 2)
    return place, slope / np.hypot(*slope)


def _bridge(start: Floats, back: Floats, stop: Floats, on: Floats) -> Floats:
    """Return points a pixel apart from `start` to `stop`, where the curve leads back and on."""
    chord = float(np.hypot(*(stop - start)))
    turn = float(np.arccos(np.clip(-back @ on, -1.0, 1.0)))
    handle = chord / (3.0 * np.cos(0.25 * turn) ** 2)  # of a cubic as near as can be to an arc of a circle
    corners = np.array([start, start - handle * back, stop - handle * on, stop])
    t = np.linspace(0.0, 1.0, max(3, round(1.2 * chord)))[1:-1, None]
    shares = np.hstack([(1.0 - t) ** 3, 3.0 * t * (1.0 - t) ** 2, 3.0 * t**2 * (1.0 - t), t**3])
    return np.asarray(shares @ corners)
