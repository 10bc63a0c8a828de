"""Lengths and silhouette of a detected capsule without the faults of the camera's geometry that are known.

The middle of the picture is taken to be that of the lens, on the axis of the channel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.camera import Camera
from capsbayes.image.detection import Detection
from capsbayes.measured_outline import MeasuredOutline


def straightened_lengths(detection: Detection, columns: int, camera: Camera) -> tuple[Floats, Floats]:
    """Return the lengths of a detection and the covariance of their errors, with those of the camera's numbers.

    Parameters
    ----------
    detection : Detection
        Whose status is ``DONE``, in a picture of so many columns.
    columns : int
    camera : Camera

    Returns
    -------
    (4,) array [px], (4, 4) array [px^2]
        Of L_z, L_a, L_p and l; what was not seen is NaN.
    """
    assert detection.outline is not None, "detected"
    lengths, sense = detection.lengths, detection.flow or 1
    half_width = lengths[3]
    edge = _from_middle(detection.outline.points, detection, columns)
    front, back = (edge[np.argmax(side * sense * edge[:, 0])] for side in (1, -1))
    hollow = np.array([front[0] - sense * lengths[1] / half_width, 0.0])
    points, walls = np.array([front, back, hollow]), _walls(half_width, columns)
    factors = np.append(_lengths(camera.straightened(points, walls=walls)) / _lengths(points), [1.0, 1.0])
    # L_p is no length of its own, and is seldom read: that of the others
    found = lengths * factors
    found[2] = found[0] - found[1]
    errors = camera.errors_of(points, walls=walls)
    off = half_width * (errors[:, :1, 0] - errors[:, 1:, 0])
    covariance = detection.covariance * np.outer(factors, factors)
    covariance[:2, :2] += off.T @ off
    return found, covariance


def straightened_silhouette(
    outline: MeasuredOutline, detection: Detection, columns: int, camera: Camera
) -> MeasuredOutline:
    """Return the silhouette of a detection in a picture of so many columns, with the camera's errors in its pose."""
    assert detection.walls is not None, "detected"
    half_width = detection.walls.half_width
    flow = [detection.flow, 1]
    middle = _from_middle(detection.axis[None], detection, columns)[0] * flow
    walls, places = _walls(half_width, columns), outline.points + middle
    true = camera.straightened(places * flow, walls=walls) * flow
    pose = replace(
        outline.pose,
        **{name: value.sd for name, value in camera.stated.items()},
        middle=float(0.5 * (true[:, 0].max() + true[:, 0].min())),
        walls=walls,
    )
    return replace(outline, points=true - middle, pose=pose)


def _from_middle(points: Floats, detection: Detection, columns: int) -> Floats:
    """Return points (m, 2) [px] along and across the channel from the middle of the picture on its axis, over l."""
    walls = detection.walls
    assert walls is not None, "detected"
    to_middle = (0.5 * (columns - 1) - walls.centre_column) / walls.along[0]
    middle = np.array([walls.centre_column, walls.centre_row]) + to_middle * walls.along
    away = (points - middle) / walls.half_width
    return np.stack([away @ walls.along, away @ walls.across], axis=1)


def _walls(half_width: float, columns: int) -> float:
    """Return the mean square distance over l^2 of the walls from the middle of a picture [px]."""
    return 1.0 + (0.5 * columns / half_width) ** 2 / 3.0


def _lengths(points: Floats) -> Floats:
    """Return the lengths (2,) between the first of three points and the others, along the channel."""
    return np.abs(points[0, 0] - points[1:, 0])
