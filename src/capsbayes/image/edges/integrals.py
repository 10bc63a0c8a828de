"""Centroid, area, perimeter and volume of revolution within an outline, with their errors.

Each changes in proportion to the displacement of a piece of the edge along its normal. So the errors of the points give
those of the integral: independent ones from point to point, shared ones within an arc, and the misfit of the edge's
model all around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.image.edges.extent import EDGE_FLOOR
from capsbayes.image.edges.fourier import low_harmonics, waves
from capsbayes.image.edges.outline import EdgeOutline
from capsbayes.profile import edge_lengths, following, signed_area
from capsbayes.quantity import Quantity

_DENSE = 1024


@dataclass(frozen=True)
class SilhouetteIntegrals:
    """Integrals over a silhouette.

    Parameters
    ----------
    area, perimeter : Quantity [px^2], [px]
    volume : Quantity [px^3]
        Mean of the bodies of revolution of the two halves; a concave rear, which the silhouette hides, is not
        subtracted.
    stretch_ratio : Quantity [-]
        Perimeter over that of the sphere of this volume.
    """

    area: Quantity
    perimeter: Quantity
    volume: Quantity
    stretch_ratio: Quantity


def centroid(points: Floats) -> Floats:
    """Return the centroid of the area within a closed outline (n, 2) : (2,) array."""
    after = following(points)
    cross = points[:, 0] * after[:, 1] - after[:, 0] * points[:, 1]
    return np.asarray(cross @ (points + after) / (3.0 * np.sum(cross)))


def centroid_variance(outline: EdgeOutline, direction: Floats) -> float:
    """Return the variance of the centroid's place along a unit vector [px^2], of the noise alone.

    The misfit of the edge's model shifts the centroid by the same amount in all pictures of a capsule.
    """
    lever = (outline.points - centroid(outline.points)) @ direction
    step = _steps(outline.points)
    return _variance(outline, lever * step / abs(signed_area(outline.points)))


def integrate_silhouette(
    outline: EdgeOutline, axis: Floats, across: Floats, misfit: float, shift: float = 0.0
) -> SilhouetteIntegrals:
    """Return area, perimeter, volume of revolution and stretch ratio of an outline.

    The axis of revolution is given by a point of it (2,) [px] and the unit vector (2,) across; the misfit [1/px] is the
    error of the edge's model over the square of the edge's width, the shift [px] the standard error of all edges
    together.
    """
    y = (outline.points - axis) @ across
    step = _steps(outline.points)
    along = np.array([across[1], -across[0]])
    curve, perimeter, curvature = _smooth(outline.points)
    volume, area = _volume(curve @ along, (curve - axis) @ across), abs(signed_area(curve))
    by_edge = np.stack([step, curvature * step, np.pi * np.abs(y) * step])
    sphere = (0.75 * volume / np.pi) ** (1.0 / 3.0)
    ratio = perimeter / (2.0 * np.pi * sphere)
    by_edge = np.vstack([by_edge, ratio * (by_edge[1] / perimeter - by_edge[2] / (3.0 * volume))])
    model = np.hypot(misfit * outline.edge_width**2, np.hypot(EDGE_FLOOR, shift))
    errors = [np.sqrt(_variance(outline, weight, EDGE_FLOOR) + (weight @ model) ** 2) for weight in by_edge]
    values = (area, perimeter, volume, ratio)
    return SilhouetteIntegrals(*(Quantity(value, float(error)) for value, error in zip(values, errors, strict=True)))


def _variance(outline: EdgeOutline, weight: Floats, floor: float = 0.0) -> float:
    """Return the variance of the weighted sum of the points' errors.

    The points of an arc shift against the mean of the arc: where the weights are alike, these shifts cancel.
    """
    count = np.bincount(outline.arc)
    total = np.bincount(outline.arc, weight)
    shared = total * np.hypot(outline.arc_error[np.flatnonzero(np.diff(outline.arc, prepend=-1))], floor)
    alone = (weight - (total / count)[outline.arc]) * outline.point_error
    return float(np.sum(shared**2) + np.sum(alone**2))


def _steps(points: Floats) -> Floats:
    """Return the length of the outline that each point represents : (n,) array."""
    edge = edge_lengths(points)
    return np.asarray(0.5 * (edge + np.roll(edge, 1)))


def _volume(z: Floats, y: Floats) -> float:
    """Return the mean volume of the bodies of revolution of the two halves of an outline about the axis y = 0."""
    before, after = y, np.roll(y, -1)
    mean = (before * np.abs(before) + after * np.abs(after) + (before + after) * np.abs(before + after)) / 6.0
    return 0.5 * np.pi * abs(float(np.sum(mean * (np.roll(z, -1) - z))))


def _smooth(points: Floats) -> tuple[Floats, float, Floats]:
    """Return dense points (d, 2) of the smooth curve through the points, its length, and its curvature at these."""
    order, coefficients = low_harmonics(points)
    wave, at_points = waves(order, _DENSE), waves(order, len(points))
    dense = wave @ coefficients
    speed = np.abs(wave @ (1j * order * coefficients))
    first, second = at_points @ (1j * order * coefficients), at_points @ (-(order**2) * coefficients)
    curvature = np.imag(np.conj(first) * second) / np.abs(first) ** 3
    return np.stack([dense.real, dense.imag], axis=1), float(2.0 * np.pi * speed.mean()), np.asarray(curvature)
