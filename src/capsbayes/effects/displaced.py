"""Predictions with displaced edges, with scaled lengths, and as seen through a lens that magnifies unevenly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals


def displaced(prediction: Prediction, across: Floats, along_flow: Floats) -> Prediction:
    """Displace the edges of a prediction outwards by `across` (n,) [l] along the normals, and `along_flow` (n,) [l]."""
    # The latter is the additional displacement where the normal is along the flow, elsewhere in proportion to its
    # component.
    longer = 2.0 * (across + along_flow)
    moved = replace(
        prediction, axial_extent=prediction.axial_extent + longer, axial_length=prediction.axial_length + longer
    )
    if prediction.outline is None:
        return moved
    normals = vertex_normals(prediction.outline)
    distance = across[:, None] + along_flow[:, None] * np.abs(normals[..., 0])
    return replace(moved, outline=prediction.outline + distance[..., None] * normals)


def scaled(prediction: Prediction, lengths: Floats, velocity: Floats) -> Prediction:
    """Multiply the lengths and the velocity of a prediction by factors (n,)."""
    factors = np.stack([lengths, lengths, velocity], axis=1)
    return replace(
        prediction,
        axial_extent=prediction.axial_extent * lengths,
        axial_length=prediction.axial_length * lengths,
        velocity_ratio=prediction.velocity_ratio * velocity,
        covariance=prediction.covariance * factors[:, :, None] * factors[:, None, :],
        outline=None if prediction.outline is None else prediction.outline * lengths[:, None, None],
    )


def stretched(prediction: Prediction, along_flow: Floats) -> Prediction:
    """Multiply what a prediction has along the flow, the velocity included, by factors (n,)."""
    made = scaled(prediction, along_flow, along_flow)
    if prediction.outline is None:
        return made
    factors = np.stack([along_flow, np.ones_like(along_flow)], axis=1)
    return replace(made, outline=prediction.outline * factors[:, None, :])


def warped(prediction: Prediction, displacement: Callable[[Floats], Floats], *, outline: bool) -> Prediction:
    """Displace a prediction by a field of the place in the picture, whose middle is that of the capsule."""
    # `displacement` maps places (n, k, 2) [l], columns along and across the flow, to displacements (n, k, 2) [l]. The
    # prediction has its outline, if the model has it: the rear rim is off the axis.
    half = 0.5 * prediction.axial_extent
    on_axis = np.zeros((len(half), 3, 2))
    on_axis[..., 0] = np.stack([half, -half, half - prediction.axial_length], axis=1)
    nose, end, hollow = displacement(on_axis)[..., 0].T
    moved, longer = None, nose - end
    if prediction.outline is not None:
        along = prediction.outline[..., 0]
        middle = 0.5 * (along.max(axis=1) + along.min(axis=1))
        moved = prediction.outline + displacement(prediction.outline - middle[:, None, None] * [1.0, 0.0])
        longer = np.ptp(moved[..., 0], axis=1) - np.ptp(along, axis=1)
    return replace(
        prediction,
        axial_extent=prediction.axial_extent + longer,
        axial_length=prediction.axial_length + nose - hollow,
        outline=moved if outline else None,
    )
