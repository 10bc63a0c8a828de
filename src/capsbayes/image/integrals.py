"""Centroid, area, perimeter and volume of revolution within an outline, with their errors.

Each changes in proportion to how far a piece of the edge is moved along its normal, so that the errors of the points
give those of the integral: independent ones from point to point, shared ones within an arc, and the misfit of the
edge's model all along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capsbayes.image.contour import Outline
from capsbayes.image.extent import EDGE_FLOOR

__all__ = ["Integral", "Silhouette", "centroid", "centroid_variance", "silhouette"]

Floats = NDArray[np.float64]

_HARMONICS = 0.1  # over the number of points, of the curve that lengths are taken of: noise would lengthen it
_DENSE = 1024


@dataclass(frozen=True)
class Integral:
    """A quantity and its standard error, in powers of a pixel or without unit."""

    value: float
    error: float


@dataclass(frozen=True)
class Silhouette:
    """What an outline encloses.

    Parameters
    ----------
    area, perimeter : Integral [px^2], [px]
    volume : Integral [px^3]
        Of the body of revolution, the mean of those of the two halves; a concave rear, which the silhouette hides, is
        not taken off.
    stretch_ratio : Integral [-]
        Perimeter over that of the sphere of this volume.
    """

    area: Integral
    perimeter: Integral
    volume: Integral
    stretch_ratio: Integral


def centroid(points: Floats) -> Floats:
    """Centroid of the area within a closed outline (n, 2) : (2,) array."""
    x, y = points.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return np.array([np.sum((one + np.roll(one, -1)) * cross) for one in (x, y)]) / (3.0 * np.sum(cross))


def centroid_variance(outline: Outline, direction: Floats) -> float:
    """Variance of the centroid's place along a unit vector [px^2], of the noise alone.

    The misfit of the edge's model is the same in all pictures of a capsule and moves its centroid always by as much.
    """
    apart = (outline.points - centroid(outline.points)) @ direction
    step = _steps(outline.points)
    return _noise(outline, apart * step / _area(outline.points))


def silhouette(outline: Outline, axis: Floats, across: Floats, misfit: float) -> Silhouette:
    """Area, perimeter, volume of revolution and stretch ratio of an outline.

    Parameters
    ----------
    outline : Outline
    axis : (2,) array [px]
        A point of the axis of revolution.
    across : (2,) array
        Unit vector across it.
    misfit : float [1/px]
        How far the model's edge may be from the true one, over the square of the edge's width.

    Returns
    -------
    Silhouette
    """
    y = (outline.points - axis) @ across
    step = _steps(outline.points)
    sense = np.array([across[1], -across[0]])
    curve, perimeter, curvature = _smooth(outline.points)
    volume, area = _volume(curve @ sense, (curve - axis) @ across), _area(curve)
    by_edge = np.stack([step, curvature * step, np.pi * np.abs(y) * step])
    sphere = (0.75 * volume / np.pi) ** (1.0 / 3.0)
    ratio = perimeter / (2.0 * np.pi * sphere)
    by_edge = np.vstack([by_edge, ratio * (by_edge[1] / perimeter - by_edge[2] / (3.0 * volume))])
    model = np.hypot(misfit * outline.edge_width**2, EDGE_FLOOR)
    error = [float(np.sqrt(_noise(outline, weight, EDGE_FLOOR) + (weight @ model) ** 2)) for weight in by_edge]
    values = (area, perimeter, volume, ratio)
    return Silhouette(*(Integral(value, one) for value, one in zip(values, error, strict=True)))


def _noise(outline: Outline, weight: Floats, floor: float = 0.0) -> float:
    """Variance of the sum of the points' errors with these weights.

    The shifts of the points of an arc are against its mean: they cancel where the weights are alike.
    """
    count = np.bincount(outline.arc)
    total = np.bincount(outline.arc, weight)
    shared = total * np.hypot(outline.arc_error[np.flatnonzero(np.diff(outline.arc, prepend=-1))], floor)
    alone = (weight - (total / count)[outline.arc]) * outline.point_error
    return float(np.sum(shared**2) + np.sum(alone**2))


def _steps(points: Floats) -> Floats:
    """Length of the outline that each point stands for : (n,) array."""
    edge = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    return np.asarray(0.5 * (edge + np.roll(edge, 1)))


def _area(points: Floats) -> float:
    x, y = points.T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


def _volume(z: Floats, y: Floats) -> float:
    """Mean volume of the two bodies that the halves of an outline leave when turned about the axis y = 0."""
    before, after = y, np.roll(y, -1)
    mean = (before * np.abs(before) + after * np.abs(after) + (before + after) * np.abs(before + after)) / 6.0
    return 0.5 * np.pi * abs(float(np.sum(mean * (np.roll(z, -1) - z))))


def _smooth(points: Floats) -> tuple[Floats, float, Floats]:
    """Dense points (d, 2) of the smooth curve through the points, its length, and its curvature at each of them."""
    count = len(points)
    coefficients = np.fft.fft(points @ np.array([1.0, 1j])) / count
    order = np.fft.fftfreq(count, 1.0 / count)
    kept = np.abs(order) <= _HARMONICS * count
    order, coefficients = order[kept], coefficients[kept]
    wave = np.exp(2j * np.pi * np.arange(_DENSE)[:, None] / _DENSE * order)
    dense = wave @ coefficients
    speed = np.abs(wave @ (1j * order * coefficients))
    at_points = np.exp(2j * np.pi * np.arange(count)[:, None] / count * order)
    first, second = at_points @ (1j * order * coefficients), at_points @ (-(order**2) * coefficients)
    curvature = np.imag(np.conj(first) * second) / np.abs(first) ** 3
    return np.stack([dense.real, dense.imag], axis=1), float(2.0 * np.pi * speed.mean()), np.asarray(curvature)
